"""The ICP and the flexible tracker together, on logs with images and depth.

Public: `entry.BothTrackers`, `merge.merged`.
"""
