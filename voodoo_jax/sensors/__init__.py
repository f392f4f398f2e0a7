"""Raw images of one sensor as geometry: stereo pairs as clouds, skin colour as regions. Never imports JAX.

Public: `stereo_matching`, `skin_colour`.
"""
