"""Fast decoding of messages of named 3D points that differ from an earlier one only in stamps and positions.

A list of forty markers takes two milliseconds to decode, and always has the same names. The byte offsets of its numbers
are found in one message, and verified by decoding it again with other numbers there. So results equal the decoder's to
the last bit.
"""

import struct
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np

from voodoo_jax.geometry.arrays_file import array_at
from voodoo_jax.records.messages import FARTHEST, Features

_STAMP, _PLACE = struct.Struct("<iI"), struct.Struct("<3d")  # as CDR has them, little-endian
_LITTLE_ENDIAN = b"\x01"  # second byte of such a message
_SECOND = 1_000_000_000
_KEPT = 4  # layouts of messages of one length: who is hidden changes the names
_AT_FIRST = 8  # layouts that are made before any has been of use: each costs as much as a message that is decoded


class Remembering:
    """A decoder of messages that caches their layouts."""

    def __init__(self, decode: Callable[[bytes], Any]):
        self._decode, self._known = decode, dict[int, list[Layout]]()
        self._worth = _AT_FIRST

    def __call__(self, data: bytes) -> Any:
        known = self._known.setdefault(len(data), [])
        for layout in known:
            if (found := layout.read(data)) is not None:
                self._worth += 1
                return found
        found = self._decode(data)
        if isinstance(found, Features) and self._worth and data[1:2] == _LITTLE_ENDIAN:
            self._worth -= 1
            if made := Layout.of(data, found, self._decode):
                known[:] = [made, *known][:_KEPT]
        return found


class Layout:
    """Byte offsets of the stamp and the positions of a message."""

    def __init__(self, like: Features, data: bytes, places: list[int], stamps: list[int]):
        byte = array_at(data, np.uint8)
        self._like, self._stamp = like, stamps[0] if stamps else None
        self._places = np.add.outer(places, np.arange(_PLACE.size)).ravel()
        self._stamps = np.add.outer(np.array(stamps, int), np.arange(_STAMP.size))
        constant = np.ones(len(byte), bool)
        constant[self._places] = constant[self._stamps] = False
        self._fixed = np.flatnonzero(constant)
        self._same = byte[self._fixed]

    @classmethod
    def of(cls, data: bytes, found: Features, decode: Callable[[bytes], Any]) -> "Layout | None":
        """The layout of a message with the features `found`; None if it cannot be verified."""
        values = found.values
        if values.shape[1:] != (3,) or not values.size or not values.all() or (found.stamps != found.stamp_ns).any():
            return None
        places, at = [], 0
        for value in values.tolist():
            if (at := data.find(_PLACE.pack(*value), at)) < 0:
                return None
            places.append(at)
            at += _PLACE.size
        made = cls(found, data, places, _all_of(data, found.stamp_ns))
        other = values[::-1] / 2 + np.arange(1, 1 + values.size).reshape(values.shape)
        changed = made._with(data, other, found.stamp_ns + _SECOND + 1)
        try:
            proved = (read := made.read(changed)) is not None and _same(read, decode(changed))
        except Exception:  # what looked like a place was a text, or how long one is
            return None
        return made if proved else None

    def _with(self, data: bytes, values: np.ndarray, stamp_ns: int) -> bytes:
        """The message with other numbers."""
        byte = array_at(data, np.uint8).copy()
        byte[self._places] = values.astype("<f8").ravel().view(np.uint8)
        byte[self._stamps] = array_at(_STAMP.pack(*divmod(stamp_ns, _SECOND)), np.uint8)
        return byte.tobytes()

    def read(self, data: bytes) -> Features | None:
        """The features of a message of the same length; None if it differs in more than its numbers, or if these are
        unusual (the decoder recognises placeholders for hidden markers)."""
        byte = array_at(data, np.uint8)
        if not np.array_equal(byte[self._fixed], self._same):
            return None
        stamps, values = byte[self._stamps], byte[self._places].view("<f8").reshape(-1, 3)
        if (stamps != stamps[:1]).any() or not ((np.abs(values) < FARTHEST) & (values != 0)).all():
            return None
        seconds, nanoseconds = (0, 0) if self._stamp is None else _STAMP.unpack_from(data, self._stamp)
        stamp_ns = seconds * _SECOND + nanoseconds
        return replace(self._like, stamp_ns=stamp_ns, values=values, stamps=np.full(len(values), stamp_ns, np.int64))


def _all_of(data: bytes, stamp_ns: int) -> list[int]:
    """Where a stamp stands, if there is one."""
    places, said = [], b"" if stamp_ns == 0 else _STAMP.pack(*divmod(stamp_ns, _SECOND))
    at = data.find(said) if said else -1
    while at >= 0:
        places.append(at)
        at = data.find(said, at + _STAMP.size)
    return places


def _same(one: Features, other: Any) -> bool:
    return isinstance(other, Features) and all(
        np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(Features)
    )
