"""What real sensors and rooms do to a recording: what is hardly seen, stands before the person, or is cut off."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.common import slow_noise
from experiments.judged import Recorded
from voodoo_jax.records.observation import with_places
from voodoo_jax.records.recording import Frame
from voodoo_jax.simulate.room import Box, hit_box

DARK = 0.15  # of their points are left where clothes or hair swallow the light
EDGES = 0.6  # of the pixels at the edge of something near lie between it and what is behind it
WAVES = (0.02, 1.5)  # error of a phase camera's distances: amplitude and length, metres
HOLES, WIDTH = 25, (1.0, 4.0)  # in a picture, and half their width in degrees
LEGS = (("hip", "knee", 0.18), ("knee", "talocrural", 0.14))  # joints, and distance from the line between, metres


def with_points(frame: Frame, keep: np.ndarray) -> Frame:
    """The frame with some of its points."""
    part, weight = (None if a is None else a[keep] for a in (frame.part, frame.weight))
    return replace(frame, points=frame.points[keep], sensor=frame.sensor[keep], part=part, weight=weight)


def at_distances(recorded: Recorded, seed: int, seen: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Recorded:
    """Every point moved along its ray: `seen` gives its distance from the true one and a standard normal number."""

    def one(frame, _, rng):
        origin, ray, distance = _rays(frame)
        moved = origin + ray * seen(distance, rng.standard_normal(distance.shape))
        return replace(frame, points=moved.astype(np.float32))

    return _each(recorded, one, seed)


def _each(recorded: Recorded, one: Callable[[Frame, Callable, np.random.Generator], Frame], seed: int = 0) -> Recorded:
    """Every frame changed: `one` gets it, where joints are in it (by name, metres) and random numbers."""
    rng = np.random.default_rng(seed)

    def at(frame: Frame) -> Callable[[str], np.ndarray]:
        joints = recorded.joints[np.argmin(np.abs(recorded.stamps - frame.time_ns))]
        return lambda name: joints[recorded.names.index(name)]

    return replace(recorded, frames=[one(f, at(f), rng) for f in recorded.frames])


def _rays(frame: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins, directions and distances of a frame's points."""
    origin = frame.origins[frame.sensor]
    distance = np.linalg.norm(frame.points - origin, axis=1, keepdims=True)
    return origin, (frame.points - origin) / distance, distance


def dark_legs(recorded: Recorded) -> Recorded:
    def one(frame, joint, rng):
        height = frame.points @ recorded.up
        leg = np.zeros(len(height), bool)
        for side in "lr":
            for first, second, width in LEGS:
                a, b = joint(f"{side}_{first}"), joint(f"{side}_{second}")
                along = np.clip((frame.points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
                leg |= np.linalg.norm(frame.points - a - along[:, None] * (b - a), axis=1) < width
        leg &= (height < joint("l_hip") @ recorded.up + 0.03) & (height > 0.04)
        return with_points(frame, ~leg | (rng.random(len(leg)) < DARK))

    return _each(recorded, one)


def dark_hair(recorded: Recorded) -> Recorded:
    def one(frame, joint, rng):
        away = frame.points - joint("skullbase")
        above = away @ recorded.up
        hair = (above > 0.08) & (above < 0.4)
        hair &= np.linalg.norm(away - above[:, None] * recorded.up, axis=1) < 0.25
        return with_points(frame, ~hair | (rng.random(len(hair)) < DARK))

    return _each(recorded, one)


def flying_pixels(recorded: Recorded) -> Recorded:
    def one(frame, _, rng):
        origin, ray, distance = _rays(frame)
        step = np.diff(distance[:, 0])  # points come row by row
        edge = (np.abs(step) > 0.15) & (np.linalg.norm(np.diff(ray, axis=0), axis=1) < 0.02)
        at = np.flatnonzero(edge & (rng.random(len(edge)) < EDGES))
        distance[at, 0] += rng.random(len(at)) * step[at]
        return replace(frame, points=(origin + ray * distance).astype(np.float32))

    return _each(recorded, one)


def swaying(recorded: Recorded, degrees: float, metres: float, over: float, told_where: bool) -> Recorded:
    """A camera that turns and shifts by so much (standard deviations) over so many frames, and says that it stands.

    `told_where`: it stands in a room, and the truth with it; else its own frame is all that there is.
    """
    rng, count = np.random.default_rng(5), len(recorded.frames)
    sway = np.stack([slow_noise(rng, count, over, reach=30) for _ in range(6)], 1)
    frame_of = np.argmin(np.abs(recorded.stamps[:, None] - [f.time_ns for f in recorded.frames]), 1)
    found, joints = [], recorded.joints.copy()
    for i, (f, (*turn, x, y, z)) in enumerate(zip(recorded.frames, sway)):
        way, shift = Rotation.from_rotvec(np.deg2rad(degrees) * np.array(turn)), metres * np.array([x, y, z])

        def place(points, way=way, origin=f.origins[0], shift=shift):
            flat = np.reshape(points, (-1, 3))
            return (way.apply(flat - origin) + origin + shift).reshape(np.shape(points)).astype(np.float32)

        moved = with_places(f, place, lambda v, way=way: way.apply(v).astype(np.float32))
        found.append(replace(moved, origins=f.origins))
        if not told_where:
            joints[frame_of == i] = place(recorded.joints[frame_of == i])
    return replace(recorded, frames=found, joints=joints)


def holes(recorded: Recorded) -> Recorded:
    def one(frame, _, rng):
        x, y, z = _rays(frame)[1].T
        level, rise = np.arctan2(y, x), np.arcsin(z)
        keep = np.ones(len(x), bool)
        for _ in range(HOLES):
            half = np.deg2rad(rng.uniform(*WIDTH))
            apart = [np.abs(a - rng.uniform(a.min(), a.max())) for a in (level, rise)]
            keep &= np.maximum(*apart) > half
        return with_points(frame, keep)

    return _each(recorded, one)


def behind_box(recorded: Recorded, box: Box) -> Recorded:
    """A box that hides what is behind it."""

    def one(frame, _, rng):
        origin, ray, distance = _rays(frame)
        with np.errstate(divide="ignore", invalid="ignore"):
            first = hit_box(box, origin, ray)[0][:, None]
        hit = (first > 0) & (first < distance)
        seen = np.where(hit, first + 0.008 * rng.standard_normal(first.shape), distance)
        return replace(frame, points=(origin + ray * seen).astype(np.float32))

    return _each(recorded, one)


def behind_desk(recorded: Recorded) -> Recorded:
    """A desk 0.45 m before where the person comes nearest to the camera."""
    y = recorded.joints[:, recorded.names.index("l_hip"), 1].mean()
    return behind_box(recorded, Box(recorded.joints[:, :, 0].min() - 0.65, y, (0.4, 1.2, 0.7)))


def behind_pole(recorded: Recorded) -> Recorded:
    """A pole of 8 cm on the way to where the person mostly is."""
    x, y = 0.45 * recorded.joints[:, recorded.names.index("l_hip"), :2].mean(0)
    return behind_box(recorded, Box(x, y, (0.1, 0.08, 2.5)))


def with_cupboard(recorded: Recorded, size: tuple[float, float, float]) -> Recorded:
    """A thing as tall as a person, behind the person and beside where they go."""
    x, y, _ = np.moveaxis(recorded.joints, -1, 0)
    side = 1 if np.median(y) < 0 else -1  # where there is more room in the picture
    aside = side * (np.abs(y - np.median(y)).max() + 0.35 + size[1] / 2)
    return behind_box(recorded, Box(np.median(x) + 0.7, np.median(y) + aside, size))


def cut_off(recorded: Recorded) -> Recorded:
    """The picture ends at the middle of the thigh: no floor, no legs."""

    def one(frame, joint, _):
        rise = lambda v: (v @ recorded.up) / np.linalg.norm(v, axis=-1)  # noqa: E731
        thigh = (joint("l_hip") + joint("l_knee")) / 2 - frame.origins[0]
        return with_points(frame, (rise(frame.points - frame.origins[0]) > rise(thigh)) & (frame.sensor == 0))

    return _each(recorded, one)


def as_the_camera_sees(recorded: Recorded) -> Recorded:
    """In the camera's frame (x right, y down, z ahead) as if nobody had said where that is: no floor at z = 0."""
    axes, origin = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]), recorded.frames[0].origins[0].astype(float)
    turned = lambda v: (v @ axes.T).astype(np.float32)  # noqa: E731
    moved = lambda p: turned(p - origin)  # noqa: E731
    frames = [with_places(f, moved, turned) for f in recorded.frames]
    return replace(recorded, frames=frames, up=turned(recorded.up), joints=(recorded.joints - origin) @ axes.T)


SENSING: dict[str, Callable[[Recorded], Recorded]] = {
    "dark trousers": dark_legs,
    "dark hair": dark_hair,
    "flying pixels at most edges": flying_pixels,
    "holes in the picture": holes,
    "distances 2 cm wrong in waves": lambda r: at_distances(
        r, 0, lambda d, _: d + WAVES[0] * np.sin(2 * np.pi * d / WAVES[1])
    ),
    "camera shakes": partial(swaying, degrees=0.4, metres=0.005, over=3, told_where=True),
    "camera in a hand": partial(swaying, degrees=1.3, metres=0.02, over=9, told_where=False),
    "behind a desk": behind_desk,
    "behind a pole": behind_pole,
    "a cupboard behind": lambda r: with_cupboard(r, (0.6, 0.8, 1.9)),
    "a full coat stand behind": lambda r: with_cupboard(r, (0.4, 0.4, 1.75)),
    "cut off at the thighs": cut_off,
    "the same, floor unknown": lambda r: as_the_camera_sees(cut_off(r)),
}
