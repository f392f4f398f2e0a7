"""Logs that are still being recorded: what has come so far, as frames.

Never imports JAX.
"""
