"""Recordings of other formats as MCAP logs.

Public: `sources.convert`, `sources.is_foreign`.
"""
