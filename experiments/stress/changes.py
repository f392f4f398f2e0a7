"""What is done to recordings after reading: fewer frames or points, noise, cuts, gaps, time reversed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from experiments.judged import Recorded
from experiments.stress.sensing import SENSING, at_distances, with_points
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import with_places
from voodoo_jax.records.recording import Pairs, Rays

STEPS = 580 * 0.075 * 8  # a Kinect's number of steps at 1 m: focal length (pixels), baseline (metres), parts of a pixel
SIGMA = (0.004, 0.0015)  # of the recordings' camera: metres, and per metre of the squared distance
GAP = 1.0  # seconds out of view
PAUSE = 0.3  # seconds without a frame
CHILD = 0.65


def _frames(recorded: Recorded, keep: Callable[[int, float], bool]) -> Recorded:
    """The frames of which `keep` (index, share of the recording's time) is true."""
    first, last = recorded.frames[0].time_ns, recorded.frames[-1].time_ns
    share = [(f.time_ns - first) / max(last - first, 1) for f in recorded.frames]
    return replace(recorded, frames=[f for i, f in enumerate(recorded.frames) if keep(i, share[i])])


def _cut(recorded: Recorded, start_ns: float) -> Recorded:
    """What comes after `start_ns`."""
    late = recorded.stamps >= start_ns
    frames = [f for f in recorded.frames if f.time_ns >= start_ns]
    return replace(
        recorded, frames=frames, stamps=recorded.stamps[late], joints=recorded.joints[late], there=recorded.there[late]
    )


def _gap_share(recorded: Recorded) -> float:
    """Of a sixth of the recording, what a gap of PAUSE takes."""
    return 6 * PAUSE * 1e9 / (recorded.frames[-1].time_ns - recorded.frames[0].time_ns)


def some_of_the_points(recorded: Recorded, share: float) -> Recorded:
    """A random choice of every frame's points."""
    rng = np.random.default_rng(0)
    return replace(recorded, frames=[with_points(f, rng.random(len(f.points)) < share) for f in recorded.frames])


def as_a_child(recorded: Recorded) -> Recorded:
    """The whole world at CHILD of its size: people of 1.0 to 1.3 m, from nearer."""
    frames = [with_places(f, lambda points: (CHILD * points).astype(np.float32)) for f in recorded.frames]
    dims = {name: CHILD * size for name, size in recorded.dims.items()}
    return replace(recorded, frames=frames, joints=CHILD * recorded.joints, dims=dims)


def thrice_the_noise(recorded: Recorded) -> Recorded:
    """Noise along the ray, so much that with what is there already it is three times the camera's."""
    factor = np.sqrt(3.0**2 - 1)
    return at_distances(recorded, 0, lambda d, normal: d + factor * (SIGMA[0] + SIGMA[1] * d**2) * normal)


def in_steps(recorded: Recorded) -> Recorded:
    """Distances in the steps of a structured-light sensor, 2.6 cm at 3 m, 7 cm at 5 m, and noise of 0.4 of a step."""
    return at_distances(recorded, 1, lambda d, normal: STEPS / np.maximum(np.round(STEPS / d + 0.4 * normal), 1))


def reversed_in_time(recorded: Recorded) -> Recorded:
    """The last frame first."""
    ends = recorded.frames[0].time_ns + recorded.frames[-1].time_ns
    turned = [replace(f, time_ns=ends - f.time_ns) for f in recorded.frames[::-1]]
    return replace(
        recorded, frames=turned, stamps=ends - recorded.stamps[::-1], joints=recorded.joints[::-1],
        there=recorded.there[::-1],
    )  # fmt: skip


def away_and_back(recorded: Recorded, body: Body, settings: Settings) -> Recorded:
    """Without the person for a second in the middle: neither their points nor their features."""
    people = find_body(recorded.frames, recorded.up, body, settings)[1]
    middle = (recorded.frames[0].time_ns + recorded.frames[-1].time_ns) / 2
    gap = lambda ns: np.abs(ns - middle) < GAP / 2 * 1e9  # noqa: E731
    frames = []
    for frame, person in zip(recorded.frames, people):
        if gap(frame.time_ns):
            mine = {tuple(p) for p in person.points.tolist()}
            keep = np.array([tuple(p) not in mine for p in frame.points.tolist()], bool)
            frame = replace(with_points(frame, keep), rays=Rays(), pairs=Pairs())
        frames.append(frame)
    return replace(recorded, frames=frames, there=recorded.there & ~gap(recorded.stamps))


def without_features(recorded: Recorded) -> Recorded:
    """As --read.no-features."""
    return replace(recorded, frames=[replace(f, rays=Rays(), pairs=Pairs()) for f in recorded.frames])


def later(recorded: Recorded, seconds: float = 0.0, share: float = 0.0) -> Recorded:
    """Without the first seconds and the first share."""
    first, last = recorded.frames[0].time_ns, recorded.frames[-1].time_ns
    return _cut(recorded, first + seconds * 1e9 + share * (last - first))


def changes(body: Body, settings: Settings) -> dict[str, Callable[[Recorded], Recorded]]:
    """All changes by name. `body` and `settings` tell the person apart where one of them needs that."""
    return {
        "as they are": lambda r: r,
        "depth only": without_features,
        "every second frame": lambda r: _frames(r, lambda i, _: i % 2 == 0),
        "every third frame": lambda r: _frames(r, lambda i, _: i % 3 == 0),
        "every fifth frame": lambda r: _frames(r, lambda i, _: i % 5 == 0),
        "every tenth frame missing": lambda r: _frames(r, lambda i, _: i % 10 != 9),
        "five gaps of 0.3 s": lambda r: _frames(r, lambda _, share: share < 1 / 9 or share * 6 % 1 > _gap_share(r)),
        "half of the points": lambda r: some_of_the_points(r, 0.5),
        "one point in eight": lambda r: some_of_the_points(r, 1 / 8),
        "three times the noise": thrice_the_noise,
        "distances in a Kinect's steps": in_steps,
        "first half second cut off": lambda r: later(r, seconds=0.5),
        "first 40 % cut off": lambda r: later(r, share=0.4),
        "a child of 1.0 to 1.3 m": as_a_child,
        "reversed in time": reversed_in_time,
        "out of view for 1 s": lambda r: away_and_back(r, body, settings),
        **SENSING,
    }
