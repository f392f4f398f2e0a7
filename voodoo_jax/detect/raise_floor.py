"""Uses the top of a treadmill, a stage or a step as the floor of the person on it. Host side, NumPy."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float32

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import TELLING, Build
from voodoo_jax.detect.heads import APART
from voodoo_jax.detect.scene import UPRIGHT, filled
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.detect.stage import Surroundings
from voodoo_jax.geometry.plane import Plane, fit_plane
from voodoo_jax.geometry.voxels import cells_of, unique_cells, within
from voodoo_jax.records.observation import BodyObservation, whole
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

LOWEST, HIGHEST = 0.08, 0.45  # metres above the floor: of its top
BIN = 0.02  # metres of height in which points are counted
EVEN = 0.03  # metres from its top of the points on it
CELL, LARGE = 0.1, 30  # metres, and cells of its top that are seen, at least
FLAT = 3.0  # times as many points as in a layer above it
BESIDE = 0.1  # metres from a person: may be their own points
FEET = 0.2  # metres above it
AROUND = 0.2, 0.5  # metres from the feet where its top is visible ...
FEW = 0.02  # of as many points as in the direction with most
SECTORS, SEEN = 8, 6  # directions, and in how many of them, at least
BACK, LENGTH = 0.7, 1.4  # metres: of the back of a sofa, above its seat at most, and from end to end; by hand


@dataclass(frozen=True)
class RaiseFloor:
    """Raises the floor to the level object that the person stands on."""

    name: ClassVar = "raise_floor"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset()

    def __call__(self, found: Surroundings) -> Surroundings:
        return replace(found, scene=on_its_floor(found.some, found.scene, found.build, found.settings))


def on_its_floor(frames: Sequence[Frame], scene: Scene, body: Build, settings: DetectSettings) -> Scene:
    """The scene, with its floor at the level object that the person stands on, if all frames with a body show this."""
    frames = [frame for frame in frames if len(frame.points)]
    for top in level_tops(frames[0], scene) if frames else ():
        raised = _raised(scene, top)
        finder = BodySegmenter(raised, body, settings)
        stands = [_stands(frame, raised, finder := finder.another(settings)) for frame in frames]
        if True in stands and False not in stands:
            return raised
    return scene


def _raised(scene: Scene, top: float) -> Scene:
    """The scene with its floor raised by metres."""
    floor = replace(scene.floor, offset=scene.floor.offset + top)
    return replace(scene, floor=floor, floor_seen=True, floor_open=False)


def with_beds(frame: Frame, scene: Scene, highest: float) -> list[Scene]:
    """The scene with each of the level tops as its floor, the largest first, and with an object behind it, such as the
    back of a sofa, as a wall; and the scene itself."""
    found = []
    for top in level_tops(frame, scene, highest):
        raised = _raised(scene, top)
        backs = _backs(whole(frame), raised)
        # who lies on their side may seem to be one
        found += [replace(raised, walls=(*scene.walls, *backs)), *([raised] if backs else [])]
    return [*found, scene]


def _backs(frame: BodyObservation, raised: Scene) -> list[Plane]:
    """An upright face above a level top, longer than a body's width and higher than a lying body."""
    height = raised.floor.height(frame.points)
    some = (height > LOWEST) & (height < BACK)
    for wall in raised.walls:
        some &= np.abs(wall.height(frame.points)) > 2 * LOWEST
    points = frame.points[some]
    fit = fit_plane(points, lambda n: np.abs(n @ raised.floor.normal) < UPRIGHT, np.random.default_rng(0), EVEN)
    if fit is None:
        return []
    plane, inside = fit
    along = points[inside] @ np.cross(raised.floor.normal, plane.normal)
    if filled(along, raised.floor.height(points[inside])) < LENGTH or np.percentile(height[some][inside], 90) < APART:
        return []
    side = 1 if plane.height(frame.origins[:1])[0] > 0 else -1
    return [Plane(side * plane.normal, side * plane.offset)]


def level_tops(frame: Frame, scene: Scene, highest: float = HIGHEST) -> list[float]:
    """Heights of level surfaces above the floor, up to the `highest`, metres; the largest first."""
    found, height = [], scene.floor.height(frame.points)
    last = int(highest / BIN) + 2
    count = np.bincount(np.clip(height / BIN, 0, last).astype(int), minlength=last + 1)
    for k in range(int(LOWEST / BIN), int(highest / BIN)):
        if count[k] == 0 or count[k] < count[k - 2 : k + 3].max():
            continue
        top = float(np.median(height[np.abs(height - (k + 0.5) * BIN) < EVEN]))
        on = np.abs(height - top) < EVEN
        above = (height > top + 2 * EVEN) & (height < top + 4 * EVEN)
        cells = len(unique_cells(cells_of(scene.floor.level(frame.points[on]), CELL))[0])
        if cells >= LARGE and on.sum() > FLAT * above.sum():
            found.append((cells, top))
    return [top for _, top in sorted(found, reverse=True)]


def _stands(frame: Frame, raised: Scene, finder: BodySegmenter) -> bool | None:
    """Whether a person stands on the raised floor; None: no person is visible."""
    seen = finder(frame).points
    if len(seen) < TELLING:
        return None
    floor = raised.floor
    feet = seen[floor.height(seen) < FEET]
    top = frame.points[np.abs(floor.height(frame.points)) < EVEN]
    top = top[~within(top, seen, BESIDE)]
    if len(feet) < 5 or not len(top):
        return False
    return _around(floor.level(top), np.median(floor.level(feet), 0), floor.normal) >= SEEN


def _around(points: Float32[np.ndarray, "point 3"], place: Float32[np.ndarray, "3"], normal) -> int:
    """Number of directions from a place in which there are enough points near it."""
    first, second = np.linalg.svd(normal[None])[2][1:]
    away = points - place
    distance = np.linalg.norm(away, axis=1)
    away = away[(distance > AROUND[0]) & (distance < AROUND[1])]
    angle = np.arctan2(away @ second, away @ first)
    count = np.bincount(((angle / np.pi + 1) / 2 * SECTORS).astype(int) % SECTORS, minlength=SECTORS)
    return int(np.sum(count > FEW * count.max()))
