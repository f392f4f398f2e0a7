"""A body is followed through observations: one package for each method.

Public: `icp.tracker.track`, `smoothing.smooth`.
"""
