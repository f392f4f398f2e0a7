"""The tracker by articulated ICP (Knoop et al. 2006, 2007).

Public: `entry.IcpTracker`, `tracker.track_person`, `people.track_subjects`.
"""
