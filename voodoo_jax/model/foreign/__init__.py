"""Bodies of other formats: URDF and skinned meshes (glTF) as body files.

Public: `sources.body_from`.
"""
