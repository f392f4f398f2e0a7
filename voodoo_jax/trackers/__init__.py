"""A body is followed through observations: one package for each method.

Public: `front.track`, `base.TRACKERS`, `smoothing.smooth`.
"""
