"""The exception of failed conversions, and the mark of converted logs. Imports nothing."""

LIBRARY = "voodoo_jax convert"  # which wrote a log, as its header says


class ConvertError(ValueError):
    """A recording cannot be converted; the text states the reason and the remedy."""
