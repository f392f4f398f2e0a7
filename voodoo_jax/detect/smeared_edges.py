"""Detects depth cameras that smear edges, by their first images. Host side, NumPy."""

import numpy as np

from voodoo_jax.detect.units import FIRST
from voodoo_jax.geometry.depth_edges import SMEARED, between_edges
from voodoo_jax.io.log_reader import LogReader
from voodoo_jax.records.messages import Image


def without_smeared_edges(reader: LogReader) -> LogReader:
    """The reader, without points at smeared depth edges, and with a note."""
    found = frozenset(topic for topic in reader.sensors if _smeared(reader, topic))
    for topic in sorted(found):
        reader.say(
            f"Depth edges in '{topic}' are smeared, as by a filter of its camera: points between near and far "
            "objects are left out."
        )
    return reader.without_sheets(found) if found else reader


def _smeared(reader: LogReader, topic: str) -> bool:
    if not reader.is_image(topic):
        return False
    images = [content for s in reader.sampled(topic, FIRST) if isinstance(content := s.content, Image)]
    shares = [between_edges(z) for image in images if (z := reader.depth(topic, image)) is not None]
    return bool(shares) and float(np.median(shares)) > SMEARED
