"""Common parts of the trackers of 3D points: compiled programs, segments, and their tracks."""
