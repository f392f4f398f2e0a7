"""Rigid poses, planes, voxels, point clouds and lenses. Nothing here knows of bodies or logs."""
