"""A learned eye: a small network on one frame's points, trained on simulated people; see README.md."""
