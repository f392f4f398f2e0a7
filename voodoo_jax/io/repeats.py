"""Detects frozen sensors: a driver that hangs, or a relay faster than its sensor, sends the last image again with a new
stamp. Real noise never repeats."""

from collections import Counter
from typing import NamedTuple

import numpy as np

from voodoo_jax.io.as_shown import TELLING
from voodoo_jax.io.decode.image_codec import raw_of
from voodoo_jax.records.messages import Cloud, Image

# share of the pixels with data that differ between pictures of a sensor with noise, at least: without noise only who
# moves differs. Measured: 0.36 to 1.0 in recordings of seven kinds of sensors
NOISY = 0.2
ROWS = 8  # every so many-th row is compared first; by hand


class _Shown(NamedTuple):
    """What a message shows, as it lies in the message."""

    packed: bytes | None  # of a compressed image
    parts: tuple[np.ndarray, ...]  # arrays of whole numbers, or of numbers taken for such

    def same(self, other: "_Shown") -> bool:
        if self.packed is not None or other.packed is not None:
            return self.packed == other.packed
        pairs = list(zip(self.parts, other.parts))
        if len(self.parts) != len(other.parts) or any(a.shape != b.shape for a, b in pairs):
            return False
        return all(np.array_equal(a[::ROWS], b[::ROWS]) for a, b in pairs) and all(
            np.array_equal(a, b) for a, b in pairs
        )


class Repeats:
    """Detects messages that repeat the previous one of their topic."""

    def __init__(self):
        self._last: dict[str, tuple[Cloud | Image, _Shown]] = {}
        self._before: dict[str, Cloud | Image] = {}  # the last one that was another
        self._at_first: Counter[str] = Counter()  # how many have repeated the first one
        self.began: dict[str, int] = {}  # the same of topics whose messages differ everywhere since

    def again(self, topic: str, content: Cloud | Image) -> bool:
        """Whether a message repeats the previous one, in a topic whose messages usually differ everywhere: two images
        of a simulated sensor without noise may be equal."""
        shown = _shown(content)
        last = self._last.get(topic)
        if shown is None:
            return False
        before = self._before.get(topic)
        if last is not None and last[1].same(shown):
            if before is None:
                # what never changes while others do shows nobody who moves: frozen, or a still room without noise
                if any(other != topic for other in self._before) and _seen(_distances(content)).sum() >= TELLING:
                    return True
                self._at_first[topic] += 1
            return before is not None and differing(last[0], before) >= NOISY
        if last is not None:
            if before is None and self._at_first[topic] and differing(content, last[0]) >= NOISY:
                self.began[topic] = self._at_first[topic]
            self._before[topic] = last[0]
        self._last[topic] = content, shown
        return False


def differing(one: Cloud | Image, other: Cloud | Image) -> float:
    """Share of the pixels (or points) with data in both that differ; 0 where hardly any have."""
    a, b = _distances(one), _distances(other)
    seen = _seen(a), _seen(b)
    if min(int(x.sum()) for x in seen) < TELLING:
        return 0.0
    if a.shape != b.shape:
        return 1.0
    both = seen[0] & seen[1]
    return float((a[both] != b[both]).mean()) if both.sum() >= TELLING else 0.0


def _shown(content: Cloud | Image) -> _Shown | None:
    if isinstance(content, Cloud):
        return _Shown(None, tuple(_whole(content.grid[axis]) for axis in "xyz"))
    if content.packed is not None:
        return _Shown(content.packed[content.start :], ())
    return None if content.raw is None else _Shown(None, (_whole(content.raw),))


def _whole(numbers: np.ndarray) -> np.ndarray:
    """Numbers taken for whole ones, byte for byte: NaN is equal to itself then."""
    return numbers.view(f"u{numbers.dtype.itemsize}") if numbers.dtype.kind == "f" else numbers


def _seen(distances: np.ndarray) -> np.ndarray:
    return np.isfinite(distances) & (distances != 0)


def _distances(content: Cloud | Image) -> np.ndarray:
    if isinstance(content, Cloud):
        return np.asarray(content.grid["x"], float)
    raw = raw_of(content)
    return np.zeros(0) if raw is None else np.asarray(raw, float)
