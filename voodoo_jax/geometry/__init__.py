"""Rigid poses, planes, voxels, point clouds, lenses and a robust loss. Nothing here knows of bodies or logs."""
