"""Lists of markers whose layout is known are read as the decoder reads them, to the last bit."""

from dataclasses import fields

import numpy as np
from mcap.records import Channel, Schema

from tests.support.logs import START, definition, ros_marker, ros_markers, serialise
from voodoo_jax.io.decode.landmark_layout import Remembering
from voodoo_jax.io.decode.registry import Decoder
from voodoo_jax.records.messages import Features

NAMES = ("LFHD", "C7", "a long name", "x")
CHANNEL = Channel(id=1, topic="/markers", message_encoding="cdr", metadata={}, schema_id=1)


def markers(stamp_ns: int, places: np.ndarray, names=NAMES, **more):
    return ros_markers(*(ros_marker(stamp_ns, "lab", n, p, i, **more) for i, (n, p) in enumerate(zip(names, places))))


def decoder_of(message) -> tuple[Schema, bytes]:
    name, encoding, data = serialise(message)
    return Schema(id=1, name=name, encoding="ros2msg", data=definition(name, encoding, message)), data


def assert_same(found: Features, wanted: Features) -> None:
    for f in fields(Features):
        one, other = getattr(found, f.name), getattr(wanted, f.name)
        assert type(one) is type(other)
        if isinstance(one, np.ndarray):
            assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), f.name
        else:
            assert one == other, f.name


def counted(message) -> tuple[Remembering, list[int]]:
    """A decoder that remembers, and the lengths of what it has decoded in full."""
    (schema, _), full = decoder_of(message), []

    def decode(data: bytes):
        full.append(len(data))
        return Decoder().message(schema, CHANNEL, data)

    return Remembering(decode), full


def test_same_bits_and_seldom_decoded():
    """Places that equal a marker's size, or one another, are no trap; four decodings do for a hundred messages."""
    rng = np.random.default_rng(0)
    places = rng.normal(size=(100, 4, 3))
    places[0] = 0.01  # as ros_marker has sizes
    read, full = counted(markers(START, places[0]))
    for i, at in enumerate(places):
        schema, data = decoder_of(markers(START + 10_000_000 * i, at))
        assert_same(read(data), Decoder().message(schema, CHANNEL, data))
    assert len(full) == 4  # of the first message no layout can be proved


def test_what_is_unusual_is_decoded():
    """Other names or frames of the same length, hidden markers, no numbers, stamps that differ, lists, no stamp."""
    rng = np.random.default_rng(0)
    places, other = rng.normal(size=(2, 4, 3)), NAMES[::-1]
    lost, none, far, flat = (places[1].copy() for _ in range(4))
    lost[1], none[2, 0], far[0, 1], flat[3, 2] = 0, np.nan, 1e10, -0.0
    mixed = markers(START, places[0])
    mixed.markers[1].header.stamp.nanosec += 1
    kinds = [
        markers(START, places[0]), markers(START + 1, places[1], other), markers(START + 2, lost),
        markers(START + 2, lost, alpha=0.0), markers(START + 3, none), markers(START + 4, far), mixed,
        markers(START + 5, flat), markers(0, places[1]), markers(START + 6, places[1], type=7, points=places[1]),
        markers(START + 7, places[0], action=2), markers(-3_000_000_001, places[1]), markers(START + 8, places[1]),
    ]  # fmt: skip
    schema, _ = decoder_of(kinds[0])
    decoder = Decoder()
    for message in [*kinds, *kinds[::-1]]:
        data = serialise(message)[2]
        assert_same(decoder.message(schema, CHANNEL, data), Decoder().message(schema, CHANNEL, data))


def test_layouts_that_are_never_of_use_are_not_made():
    """Where every message has other names, at most so many are decoded twice."""
    rng = np.random.default_rng(0)
    read, full = counted(markers(START, rng.normal(size=(4, 3))))
    for i in range(50):
        read(decoder_of(markers(START, rng.normal(size=(4, 3)), names=[f"{i:02}{k}" for k in range(4)]))[1])
    assert 50 < len(full) < 65
