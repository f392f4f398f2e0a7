"""Sizes and a first pose from named points (optical markers) alone.

Public: `table.marker_table`, `table.sized_by_markers`.
"""
