"""Pictures and pages of tracks, for people.

Public: `figures.show`, `figures.picture`.
"""
