"""Common parts of the trackers of 3D points: they pass frames through the compiled programs, segment by segment, and
make tracks."""
