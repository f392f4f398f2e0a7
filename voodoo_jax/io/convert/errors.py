"""What a conversion that fails raises, and how what it makes is known. Imports nothing."""

LIBRARY = "voodoo_jax convert"  # which wrote a log, as its header says


class ConvertError(ValueError):
    """A recording that cannot be converted, with the reason and what to do."""
