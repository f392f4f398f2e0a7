"""Converts recordings of other formats to MCAP logs.

Public: `sources.convert`, `sources.is_foreign`.
"""
