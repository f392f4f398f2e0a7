"""Refinements of what was tracked: each looks for one kind of error and tries what would be right."""
