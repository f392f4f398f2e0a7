"""How much one log may ask for: what asks for more is refused with a sentence, before memory or time is spent on it.

Together with what is kept of a log between its passes these keep reading below 2 GB (docs/limits.md). They hold for all
that is read in the same thread: what decodes a message need not be told.
"""

from voodoo_jax.config.limited import limited, limits, too_large

__all__ = ["PLACE", "QUATERNION", "TIME", "limited", "limits", "too_large"]

# Nanoseconds, the year 2116: differences of two such times fit into 64 bits.
TIME = 1 << 62
# Metres: the earth's centre is 6.4e6 m away. Above, not even float64 has the hundredth of a micrometre.
PLACE = 1e8
# Lengths of quaternions that are taken for one of length 1 with rounding: drivers round to 3 digits at worst.
QUATERNION = 1e-3, 1e3
