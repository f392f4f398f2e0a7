"""What flows through the program: frames, observations of the body, scenes, segments, tracks.

Public: `recording.Recording`, `observation.BodyObservation`, `scene.Scene`, `tracks.Tracks`.
"""
