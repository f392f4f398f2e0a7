"""How much one log may ask for: what asks for more is refused with a sentence, before memory or time is spent on it.

Together with what is kept of a log between its passes these keep reading below 2 GB (docs/limits.md).
"""

# The largest message of sensors in use is a raw image of 32 Mpixel (128 MB); recorders close chunks at some MB.
CHUNK_BYTES = 256 << 20
# Real messages have some hundred bytes; a record of one takes half a kilobyte of memory, so this is 0.5 GB.
CHUNK_RECORDS = 1 << 20
# A log of dark images packs 500 : 1 (measured); four GiB more for small ones. Zeros alone pack 10,000 : 1.
LOG_BYTES, LOG_TIMES = 4 << 30, 1000
# The largest depth cameras and stereo cameras have 4096 x 4096 pixels; rays of so many take about 1 GB.
PIXELS = 1 << 24
# Definitions of ROS with all they include have at most 30 kB, those of Foxglove 10 kB.
SCHEMA_BYTES = 128 << 10
# Fields with those of the fields: the largest of common_interfaces (InteractiveMarkerUpdate) has 800.
SCHEMA_FIELDS = 10_000
# Nanoseconds, the year 2116: differences of two such times fit into 64 bits.
TIME = 1 << 62
# Metres: the earth's centre is 6.4e6 m away. Above, not even float64 has the hundredth of a micrometre.
PLACE = 1e8
# Lengths of quaternions that are taken for one of length 1 with rounding: drivers round to 3 digits at worst.
QUATERNION = 1e-3, 1e3


def of_size(what: str, size: int, most: int, unit: str = "bytes") -> str:
    """The sentence's end for something that is too large."""
    return f"{what} {size} {unit}, more than the {most} that are allowed"
