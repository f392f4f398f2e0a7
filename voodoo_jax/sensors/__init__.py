"""Raw images of one sensor as geometry: stereo pairs as clouds, skin colour as regions, people as key points. Never
imports JAX.

Public: `stereo_matching`, `skin_colour`, `pose_net`.
"""
