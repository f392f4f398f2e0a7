"""Estimates the upward direction if a log lacks it, or assumes a level camera. Host side, NumPy."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float32
from scipy.spatial.transform import Rotation

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.scene import STEEPEST, find_scene, shows_floor
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.detect.stage import Surroundings
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

LOW = 0.5  # of its height: so low the body may be, if up is where the log says
LIKELIER = 2.0  # times as like a body something must be if another way is up
LEAST = 0.04  # so like a body it must be; measured: up to 0.024 in wrong directions, people 0.12 to 0.27

SAID = (
    "Up is ({}) in the fixed frame, unlike the log's frames: a floor with a person on it is visible. To "
    "override, set read.up."
)


@dataclass(frozen=True)
class FindGravity:
    """Estimates the upward direction if that of the log shows no body; then finds floor and walls again."""

    name: ClassVar = "find_gravity"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset()

    def __call__(self, found: Surroundings) -> Surroundings:
        up = upright(found.some, found.scene, found.up, found.up_is_sure, found.build, found.settings)
        if up is found.up:
            return found
        found = replace(found, up=up, up_is_sure=False).with_planes()
        way = ", ".join(f"{x:.1f}" for x in found.scene.floor.normal + 0.0)
        return replace(found, scene=replace(found.scene, notes=(*found.scene.notes, SAID.format(way))))


def upright(
    frames: Sequence[Frame],
    scene: Scene,
    up: Float32[np.ndarray, "3"],
    up_is_sure: bool,
    body: Build,
    settings: DetectSettings,
) -> Float32[np.ndarray, "3"]:
    """`up`, or another direction if only that gives a floor with a body-like object on it: the camera may be on its
    side, upside down, or look down. All are accurate only to some 40 degrees.

    **Arguments:** `scene` found with `up`.
    """
    if up_is_sure and scene.floor_seen:
        return up
    low = replace(settings, min_height=min(settings.min_height, LOW))  # a child's
    usual = likely_body(scene, frames, body, low, enough=0.0 if scene.floor_seen else np.inf)
    seen = max(frames, key=lambda frame: len(frame.points), default=None)
    if usual > 0 and scene.floor_seen or seen is None or not len(seen.points):
        return up
    # somebody on a floor that is seen tells more than a name, but the log's transforms are more than that
    best, likeliest = up, max(LEAST, LIKELIER * usual if up_is_sure else usual)
    for other in _others(up, seen, down=not scene.floor_seen):
        if shows_floor(seen, other):
            there = find_scene([seen], other, up_is_sure=False)
            if there.floor.height(seen.origins).max() < 0:
                continue  # no sensor is under a floor
            found = likely_body(there, frames, body, settings)
            if found > likeliest:
                best, likeliest = other, found
    return best


def _others(up: Float32[np.ndarray, "3"], seen: Frame, down: bool) -> list[Float32[np.ndarray, "3"]]:
    """Other candidates for the upward direction: rotations by 90 degrees about the viewing direction, the axes of the
    frame, and, if the sensor may look `down`, the reverse viewing direction; each more than 40 degrees, within
    which floors are found, from those before."""
    away = np.mean(seen.points - seen.origins[seen.sensor], 0)
    ahead = away / max(float(np.linalg.norm(away)), 1e-6)
    turned = [Rotation.from_rotvec(k * np.pi / 2 * ahead).apply(up) for k in (1, 2, 3)]
    found: list[np.ndarray] = []
    # a wall may be taken for a floor if another floor is seen already
    for other in (*turned, *([-ahead] if down else []), *np.eye(3), *-np.eye(3)):
        against = not down and other @ -ahead > STEEPEST
        if not against and all(other @ known < STEEPEST for known in (up, *found)):
            found.append(other.astype(np.float32))
    return found


def likely_body(
    scene: Scene, frames: Sequence[Frame], body: Build, settings: DetectSettings, enough: float = np.inf
) -> float:
    """Largest body likelihood of an object in the frames, 0..1, or the first above `enough`."""
    likely, finder = 0.0, BodySegmenter(scene, body, settings)
    for frame in frames:
        finder = finder.another(settings)
        finder(frame)
        likely = max(likely, finder.likely)
        if likely > enough:
            break
    return likely
