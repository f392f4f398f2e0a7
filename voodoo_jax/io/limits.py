"""Limits for one log: data beyond them is refused with a message, before memory or time is spent on it.

With the data kept between passes, they keep reading below 2 GB (docs/limits.md). They are thread-local, so decoders
need no argument for them.
"""

from voodoo_jax.config.limited import limited, limits, too_large

__all__ = ["PLACE", "QUATERNION", "TIME", "limited", "limits", "too_large"]

# Nanoseconds, the year 2116: differences of two such times fit into 64 bits.
TIME = 1 << 62
# Metres: the earth's centre is 6.4e6 m away. Above, not even float64 has the hundredth of a micrometre.
PLACE = 1e8
# Lengths of quaternions that are taken for one of length 1 with rounding: drivers round to 3 digits at worst.
QUATERNION = 1e-3, 1e3
