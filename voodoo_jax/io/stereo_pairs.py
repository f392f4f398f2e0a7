"""Stereo pairs of a log: finds their topics, and pairs their images while the log is read."""

import re
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.calibrations import calibration_of, fitted, rectified
from voodoo_jax.io.container import UNPACKERS, Item
from voodoo_jax.io.decode.image_codec import pixels
from voodoo_jax.io.decode.registry import Decoder
from voodoo_jax.io.frame_sync import clean_stamps
from voodoo_jax.io.topic import Topic
from voodoo_jax.io.transforms import TransformTree
from voodoo_jax.records.messages import Cloud, Colour, Image

if TYPE_CHECKING:
    from voodoo_jax.sensors.stereo_matching import StereoMatcher

STEREO_USE = "stereo pair"
HELD = 64  # images that wait for their partner; more are not kept
_SIDES = (("left", "right"), ("infra1", "infra2"))
_WORD = r"(?<![A-Za-z0-9]){}(?![A-Za-z0-9])"


@dataclass(frozen=True)
class Pair:
    """Two topics of images from one pair of cameras. `problem`: why it cannot be used; "" if it can."""

    left: str
    right: str
    rig: str  # how the topics of the rig begin
    problem: str


def picture_of(content: object) -> Colour | None:
    """The colour or grey image that a message holds."""
    return content.colour if isinstance(content, Image) else content if isinstance(content, Colour) else None


def find_pairs(topics: dict[str, Topic], tree: TransformTree) -> list[Pair]:
    """The pairs, by their topics' names: for each left camera the best of its topics (rectified, then not
    compressed)."""
    found: dict[str, Pair] = {}
    pictures = [n for n, t in topics.items() if picture_of(t.sample) is not None]
    for name in sorted(pictures, key=lambda n: (not rectified(n), topics[n].sample is picture_of(topics[n].sample), n)):
        for side, other in _SIDES:
            match = re.search(_WORD.format(side), name.replace("_", "-"))
            partner = name[: match.start()] + other + name[match.end() :] if match else ""
            if partner in pictures:
                rig, _, rest = name.partition(match.group()) if match else ("", "", "")
                pair = Pair(name, partner, rig if "/" in rest else rig.rsplit("/", 1)[0] + "/", "")
                frame = topics[name].sample.frame
                found.setdefault(frame or name, replace(pair, problem=_problem(topics, tree, pair)))
    return list(found.values())


def _problem(topics: dict[str, Topic], tree: TransformTree, pair: Pair) -> str:
    try:
        make_rig(topics, tree, pair, None)
    except ValueError as problem:
        return str(problem)
    return ""


def make_rig(topics: dict[str, Topic], tree: TransformTree, pair: Pair, shape: tuple[int, int] | None):
    """The geometry of a pair for images of `shape` (rows, columns; None: as calibrated). Raises ValueError if the
    calibrations do not fit together."""
    from voodoo_jax.sensors.stereo_rig import posed_rig, projected_rig  # with OpenCV: only for logs with pairs

    both = [calibration_of(topics, name) for name in (pair.left, pair.right)]
    for name, c in zip((pair.left, pair.right), both):
        if c is None:
            raise ValueError(f"no calibration for '{name}'")
    left, right = (fitted(c, shape or (c.height, c.width))[0] for c in both if c is not None)
    if not (left.width and left.height) or (left.width, left.height) != (right.width, right.height):
        raise ValueError("its calibrations are of different or unknown size")
    if left is right or (both[0] is both[1]):
        raise ValueError("there is one calibration for both images")
    if right.P[0, 3] != left.P[0, 3] and left.P[0, 0] > 0:
        return projected_rig(left, right, rectified(pair.left))
    a, b = topics[pair.left].sample.frame, topics[pair.right].sample.frame
    pose = tree.lookup(a, b, 0, hold_ns=None) if a != b else None
    if pose is None:
        raise ValueError(f"the distance of its cameras is unknown: P[0, 3] of the right calibration is "
                         f"{right.P[0, 3]:g}, and there is no transform between '{a}' and '{b}'")  # fmt: skip
    return posed_rig(left, right, *pose, rectified(pair.left))


def partners(left: np.ndarray, right: np.ndarray) -> dict[int, int]:
    """For each left image the right one that is nearest in time (stamps in nanoseconds, in the order of reading), at
    most a fifth of the usual interval apart; each right one once."""
    order = np.argsort(right, kind="stable")
    if not len(order) or not len(left):
        return {}
    times = right[order]
    period = float(np.median(np.diff(np.unique(left)))) if len(np.unique(left)) > 1 else 1e8
    at = np.clip(np.searchsorted(times, left), 0, len(times) - 1)
    before = np.clip(at - 1, 0, None)
    nearest = np.where(np.abs(times[before] - left) < np.abs(times[at] - left), before, at)
    gap = np.abs(times[nearest] - left)
    found: dict[int, int] = {}
    for i in np.lexsort((np.arange(len(left)), gap)).tolist():
        if gap[i] <= 0.2 * period:
            found.setdefault(int(order[nearest[i]]), i)
    return {i: j for j, i in found.items()}


class StereoReader:
    """Pairs the images of the used stereo pairs while a log is read, and makes clouds from them."""

    def __init__(self, topics: dict[str, Topic], tree: TransformTree, pairs: list[Pair], settings: ReadSettings):
        self._topics, self._tree, self._settings = topics, tree, settings
        self._decoder, self._matchers = Decoder(), dict[tuple, "StereoMatcher"]()
        self._pool, self._making = ThreadPoolExecutor(UNPACKERS), Lock()
        self.pairs = {pair.left: pair for pair in pairs}
        self.rights = {pair.right for pair in pairs}
        self._key: dict[tuple[str, int], tuple[str, int]] = {}  # (topic, number) -> (left topic, number)
        for pair in pairs:
            left, right = (clean_stamps(n, topics[n].stamps, topics[n].log_times, []) for n in (pair.left, pair.right))
            for i, j in partners(left, right).items():
                self._key[pair.left, i] = self._key[pair.right, j] = pair.left, i

    def items(self, messages: Iterable[tuple[str, int, Item]]) -> Iterator[tuple[str, int, Item, Item | None]]:
        """Numbered messages (see Scan.numbered), each with the right camera's. A left image comes when its partner has
        come, or with None if it has none or too many wait; all other messages pass at once with None."""
        held: OrderedDict[tuple[str, int], tuple[bool, Item]] = OrderedDict()
        late = set()
        for topic, number, item in messages:
            is_right = topic in self.rights
            key = self._key.get((topic, number))
            if key is None:
                if not is_right:
                    yield topic, number, item, None
            elif key in held:
                other = held.pop(key)[1]
                yield (*key, other, item) if is_right else (*key, item, other)
            elif key not in late:
                held[key] = is_right, item
                if len(held) > HELD:
                    key, (was_right, waiting) = held.popitem(last=False)
                    late.add(key)
                    if not was_right:
                        yield *key, waiting, None
            elif not is_right:
                yield *key, item, None

    def begin(self, left: Item, right: Item, fixed_frame: str, up: np.ndarray) -> Future[Cloud]:
        """The cloud of a pair of images in the left camera's frame; `up` is upwards in the fixed one. Other threads
        match the images. Raises one of DECODE_ERRORS for broken images, here or when the result is read."""
        contents = [self._decoder.message(s, c, m.data) for s, c, m in (left, right) if s is not None]
        stamp, frame = contents[0].stamp_ns, contents[0].frame
        pose = self._tree.lookup(fixed_frame, frame, stamp, hold_ns=None)
        upwards = None if pose is None else up @ pose[0]
        # the limits that hold here hold there, too
        return self._pool.submit(copy_context().run, self._cloud, left[1].topic, contents, upwards)

    def _cloud(self, topic: str, contents: Sequence[Colour | Image], upwards: np.ndarray | None) -> Cloud:
        from voodoo_jax.sensors.stereo_matching import UPWARDS, StereoMatcher

        images = [pixels(picture) for content in contents if (picture := picture_of(content)) is not None]
        if len(images) < 2:
            raise ValueError("not a colour or grey image")
        shape, s = (images[0].shape[0], images[0].shape[1]), self._settings
        with self._making:
            if (topic, shape) not in self._matchers:
                rig = make_rig(self._topics, self._tree, self.pairs[topic], shape)
                self._matchers[topic, shape] = StereoMatcher(rig, shape, s.min_range)
        up = UPWARDS if upwards is None else upwards
        points = self._matchers[topic, shape].points(images[0], images[1], s.max_points, up)
        grid = np.zeros((1, len(points)), np.dtype([(axis, "f8") for axis in "xyz"]))
        for i, axis in enumerate("xyz"):
            grid[axis] = points[:, i]
        return Cloud(contents[0].stamp_ns, contents[0].frame, grid)
