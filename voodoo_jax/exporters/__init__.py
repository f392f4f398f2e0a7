"""Tracks as files: one module for each format.

Public: `npz.write_tracks_npz`, `npz.read_tracks_npz`, `foxglove.write_tracks_mcap`.
"""
