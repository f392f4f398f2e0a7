"""One frame's solve, the scan over frames, derivatives and covariances. Array shapes are decided in `padding`.

Public: `scan.track_visits`, `through_time.track_through`, `implicit.solution`.
"""
