"""The tracker by articulated ICP (Knoop et al. 2006, 2007).

Public: `tracker.track_poses`, `people.track_subjects`.
"""
