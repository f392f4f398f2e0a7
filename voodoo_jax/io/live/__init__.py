"""Frames of logs that are still being recorded.

Never imports JAX.
"""
