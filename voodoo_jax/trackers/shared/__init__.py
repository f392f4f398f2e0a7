"""What trackers of 3D points share: frames through the compiled programs, segment after segment, and their tracks."""
