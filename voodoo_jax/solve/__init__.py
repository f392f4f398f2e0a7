"""One frame's solve, the scan over frames, derivatives and covariances. Array shapes are decided in `padding`.

Public: `scan.track_visits`, `implicit.solution`.
"""
