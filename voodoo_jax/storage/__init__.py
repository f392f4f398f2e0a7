"""Files that appear only when they are complete, and URLs used like paths. No JAX.

Public: `atomic.replacing`, `urls.expanded`, `troubles.small_text`.
"""
