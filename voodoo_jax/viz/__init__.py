"""People look at tracks.

Public: `figures.show`, `figures.picture`.
"""
