"""Decodes messages of a log: one module for each kind of content, and the table of all message types."""
