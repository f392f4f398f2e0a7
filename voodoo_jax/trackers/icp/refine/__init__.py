"""Refinements of tracks: each detects one kind of error, and tries an alternative."""
