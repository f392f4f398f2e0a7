"""Tells the body's points apart from floor, walls and furniture. Host side, NumPy; one frame at a time, no look ahead.

Nothing here knows what the body looks like but its height at rest.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float32, Int, Int32
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from voodoo_jax.recording import Frame, Pairs, Rays
from voodoo_jax.settings import PersonSettings


@dataclass(frozen=True)
class Plane:
    """Points p with normal . p = offset."""

    normal: Float32[np.ndarray, "3"]  # unit
    offset: float  # metres

    def height(self, points: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, " point"]:
        """Signed distance of points, metres."""
        return points @ self.normal - np.float32(self.offset)


@dataclass(frozen=True)
class Scene:
    """The room's planes, found once from the first frames."""

    floor: Plane  # normal upwards
    walls: tuple[Plane, ...]
    floor_seen: bool  # False: no floor was visible and the lowest points stand for it


def fit_plane(
    points: Float32[np.ndarray, "point 3"],
    normals_ok,
    rng: np.random.Generator,
    tolerance: float,
    trials: int = 300,
) -> tuple[Plane, Bool[np.ndarray, " point"]] | None:
    """The plane with the most points within `tolerance` metres (random samples of three, then least squares).

    `normals_ok(normals [trial, 3]) -> bool [trial]` says which directions are wanted. None where none was found.
    """
    if len(points) < 50:
        return None
    sample = points[rng.integers(0, len(points), (trials, 3))]
    normals = np.cross(sample[:, 1] - sample[:, 0], sample[:, 2] - sample[:, 0])
    length = np.linalg.norm(normals, axis=1)
    good = length > 1e-3
    normals = normals[good] / length[good, None]
    keep = normals_ok(normals)
    normals, at = normals[keep], sample[good][keep][:, 0]
    if not len(normals):
        return None
    subset = points[rng.permutation(len(points))[:4000]]
    near = np.abs(subset @ normals.T - np.sum(normals * at, 1)) < tolerance
    best = int(np.argmax(near.sum(0)))
    normal, offset = normals[best], float(normals[best] @ at[best])
    for _ in range(3):
        inside = np.abs(points @ normal - offset) < tolerance
        if inside.sum() < 20:
            return None
        middle = points[inside].mean(0)
        _, _, axes = np.linalg.svd(points[inside][:: max(1, int(inside.sum()) // 3000)] - middle, full_matrices=False)
        normal = axes[2] * np.sign(axes[2] @ normal or 1.0)
        offset = float(normal @ middle)
    plane = Plane(normal.astype(np.float32), offset)
    return plane, np.abs(plane.height(points)) < tolerance


def find_scene(frames: list[Frame], up: Float32[np.ndarray, "3"], up_is_sure: bool = True) -> Scene:
    """Floor and walls from a few frames: `up` need be right to 40 degrees only.

    Where no floor is visible it is taken to be z = 0 of a fixed frame whose z points up (`up_is_sure`; robots' base,
    odometry and map frames are so by convention), or else the height of the lowest points.
    """
    rng = np.random.default_rng(0)
    free = [f.only(~assigned(f)) if assigned(f).any() else f for f in map(whole, frames)]
    clouds = [f.points for f in free if len(f.points)]
    points = np.concatenate(clouds) if clouds else np.zeros((0, 3), np.float32)
    if len(points) > 60_000:
        points = points[rng.permutation(len(points))[:60_000]]
    if not len(points):  # the person's own lowest points are as near to the floor as one can know
        points = np.concatenate([np.zeros((0, 3), np.float32), *(f.points for f in frames)])
        return Scene(_lowest(points, np.asarray(up, np.float32), up_is_sure), (), False)
    floor, seen = _find_floor(points, np.asarray(up, np.float32), up_is_sure, rng)
    walls: list[Plane] = []
    for frame in free:  # one by one: a person who walks is as wide as a wall over several frames together
        if len(frame.points) and len(walls) < 6:
            walls += _find_walls(frame, floor, walls, rng)
    return Scene(floor, tuple(walls), seen)


def _find_walls(frame: "PersonFrame", floor: Plane, known: list[Plane], rng) -> list[Plane]:
    """Wide upright planes with nothing behind them."""
    points = frame.points[rng.permutation(len(frame.points))[:20_000]]
    points = points[floor.height(points) > 0.1]
    rest = points
    for wall in known:
        rest = rest[np.abs(wall.height(rest)) > 0.05]
    found: list[Plane] = []
    for _ in range(4):
        fit = fit_plane(rest, lambda n: np.abs(n @ floor.normal) < 0.17, rng, 0.04)
        if fit is None or fit[1].sum() < max(1, 0.08 * len(points)):
            break
        plane, inside = fit
        along = np.cross(floor.normal, plane.normal)
        wide = np.ptp(np.percentile(rest[inside] @ along, [2, 98]))
        side = np.sign(plane.height(frame.origins[:1]))[0]
        behind = (plane.height(points) * side < -0.15).mean()
        if wide >= 2.0 and behind <= 0.03:
            found.append(plane)
        # else a near person, who may have more points than the wall: look on without them
        rest = rest[~inside]
    return found


def _find_floor(points, up, up_is_sure, rng) -> tuple[Plane, bool]:
    height = points @ up
    low = points[height < np.percentile(height, 70)]
    found = fit_plane(low, lambda n: np.abs(n @ up) > 0.77, rng, 0.03)
    if found is not None:
        plane, _ = found
        if plane.normal @ up < 0:
            plane = Plane(-plane.normal, -plane.offset)
        above = plane.height(points)
        # a floor has next to nothing below it, and a fair share of the picture on it
        if (np.abs(above) < 0.03).mean() > 0.04 and (above < -0.1).mean() < 0.03:
            return plane, True
    return _lowest(points, up, up_is_sure), False


def _lowest(points, up, up_is_sure) -> Plane:
    """What stands for a floor that nobody sees."""
    lowest = float(np.percentile(points @ up, 0.5)) if len(points) else 0.0
    return Plane(up, 0.0 if up_is_sure and abs(lowest) < 0.2 else lowest)


def unique_cells(cells: Int[np.ndarray, "point 3"]) -> tuple[Int[np.ndarray, "cell 3"], Int[np.ndarray, " point"]]:
    """The cells that occur, in order, and which of them each entry is: np.unique by one number for each cell, which is
    several times as fast as by rows."""
    if not len(cells):
        return cells, np.zeros(0, np.int64)
    low = cells.min(0)
    span = cells.max(0) - low + 1
    if np.prod(span.astype(float)) > 2**62:
        unique, inverse = np.unique(cells, axis=0, return_inverse=True)
        return unique, inverse.ravel()
    x, y, z = (cells - low).T
    key, inverse = np.unique((x * span[1] + y) * span[2] + z, return_inverse=True)
    return np.stack([key // (span[1] * span[2]), key // span[2] % span[1], key % span[2]], 1) + low, inverse


def components(points: Float32[np.ndarray, "point 3"], link: float) -> Int[np.ndarray, " point"]:
    """Labels of connected things: points in touching cells of half of `link` metres belong together."""
    middle, inverse = unique_cells(np.floor(points / np.float32(link / 2)).astype(np.int64))
    # the 26 cells around: a distance between half and the whole of `link`
    pairs = KDTree(middle).query_pairs(1.8, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(middle),) * 2)
    return connected_components(graph, directed=False)[1][inverse]


def point_spacing(points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"]) -> float:
    """Angle between neighbouring points as seen from the sensor, radians (median)."""
    rays = points - origin
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return float(np.median(KDTree(rays).query(rays[:: max(1, len(rays) // 2000)], k=2)[0][:, 1]))


def without_strays(
    points: Float32[np.ndarray, "point 3"], origin: Float32[np.ndarray, "3"], spacing: float
) -> Bool[np.ndarray, " point"]:
    """False for flying pixels: points with fewer than three others as near as neighbours on a surface are.

    `spacing` is the sensor's, radians. Flying pixels at the edge of a near thing bridge the gap to what is behind it.
    """
    if len(points) < 5:
        return np.zeros(len(points), bool)
    near = 0.02 + 3 * spacing * np.linalg.norm(points - origin, axis=1)
    tree = KDTree(points, balanced_tree=False, compact_nodes=False)  # faster to make than it is to ask
    return tree.query(points, k=4, distance_upper_bound=1.01 * float(near.max()))[0][:, 3] < near


def fair_share(sensor: Int[np.ndarray, " point"], most: int) -> Int[np.ndarray, " kept"]:
    """Indices of about `most` points at most: of each sensor every first, second, ... point, of the densest the fewest.

    `sensor` [point] says which sensor saw each point.
    """
    counts = np.bincount(sensor)
    if len(sensor) <= most:
        return np.arange(len(sensor))
    room, share = most, 0
    for left, count in zip(range(len(counts), 0, -1), np.sort(counts)):  # what a sensor leaves is for the denser ones
        share = room // left
        room -= min(int(count), share)
    step = [1 if n <= share else int(n) // max(share, 1) + 1 for n in counts]
    return np.sort(np.concatenate([np.flatnonzero(sensor == s)[::k] for s, k in enumerate(step)]))


@dataclass(frozen=True)
class PersonFrame:
    """The points of one frame that seem to be on the body."""

    time_ns: int
    points: Float32[np.ndarray, "point 3"]  # fixed frame, metres
    sensor: Int[np.ndarray, " point"]
    origins: Float32[np.ndarray, "sensor 3"]
    rays: Rays = field(default_factory=Rays)
    pairs: Pairs = field(default_factory=Pairs)
    part: Int32[np.ndarray, " point"] | None = None  # as in Frame
    parts: tuple[str, ...] = ()
    weight: Float32[np.ndarray, " point"] | None = None

    def only(self, keep: np.ndarray) -> "PersonFrame":
        """The frame with some of its points: a mask or indices."""
        part = None if self.part is None else self.part[keep]
        weight = None if self.weight is None else self.weight[keep]
        return replace(self, points=self.points[keep], sensor=self.sensor[keep], part=part, weight=weight)


def whole(frame: Frame) -> PersonFrame:
    """A frame with all its points."""
    return PersonFrame(
        frame.time_ns, frame.points, frame.sensor, frame.origins, frame.rays, frame.pairs, frame.part, frame.parts,
        frame.weight,
    )  # fmt: skip


def assigned(frame: Frame | PersonFrame) -> Bool[np.ndarray, " point"]:
    """Which points somebody has already said to be on the body, or on one of its limbs."""
    return np.zeros(len(frame.points), bool) if frame.part is None else frame.part >= 0


STILL = 0.06  # metres from one frame's points to those of the frame before, of things that do not move


class PersonFinder:
    """Follows one thing of a body's height through the frames: first the best candidate, then what hangs together with
    where it was. Places where other things were seen several times count as background from then on.

    Points that are assigned already pass all tests; what they touch is the body, of whatever height.
    """

    def __init__(self, scene: Scene, body_height: float, settings: PersonSettings):
        self.scene, self.settings, self.body_height = scene, settings, body_height
        self.last: np.ndarray | None = None  # the body's points in the last frame that had some
        self.others = np.zeros((0, 3), np.float32)  # what was near it in the last frame, and not taken
        self.unseen = 0
        self._spacing: dict[int, float] = {}  # of each sensor
        self._background: dict[tuple[int, int, int], float] = {}  # how often seen

    def __call__(self, frame: Frame) -> PersonFrame:
        s = self.settings
        points, floor = frame.points, self.scene.floor
        known = assigned(frame)
        sure = points[known]
        if self.last is not None and len(sure):
            if np.median(KDTree(self.last).query(sure)[0]) > s.move:
                self.last = None  # the body is somewhere else than thought
        keep = (floor.height(points) > s.floor_margin) & ~known
        for wall in self.scene.walls:
            keep &= np.abs(wall.height(points)) > 0.06
        index = np.flatnonzero(keep)
        if self.last is not None:
            # flat distance only: somebody who sits down or jumps is still here
            away = points[index] - np.median(self.last, 0)
            away -= np.outer(away @ floor.normal, floor.normal)
            index = index[np.linalg.norm(away, axis=1) < s.reach * self.body_height / 1.75]
        index = self._without_strays(frame, index[fair_share(frame.sensor[index], 20_000)])
        if len(index):
            index = index[~self._known(points[index])]
        chosen = self._choose(points[index], sure)
        self.others = points[index][~chosen]
        self._learn(self.others, np.concatenate([points[index][chosen], sure]))
        # the points of a limb or two do not tell where the others are
        tells = chosen.sum() >= 30 or self._of_body(frame).sum() >= 30
        index = np.sort(np.concatenate([index[chosen], np.flatnonzero(known)]))
        if tells:
            self.last, self.unseen = points[index], 0
        else:
            self.unseen += 1
            if self.unseen > s.forget:
                self.last = None  # gone: look everywhere again
        return whole(frame).only(index)

    def _without_strays(self, frame: Frame, index: np.ndarray) -> np.ndarray:
        """The indices without those of flying pixels: each sensor's points are compared among themselves."""
        kept = []
        for sensor in np.unique(frame.sensor[index]).tolist():
            mine = index[frame.sensor[index] == sensor]
            points, origin = frame.points[mine], frame.origins[sensor]
            spacing = self._spacing.get(sensor) or (point_spacing(points, origin) if len(points) > 4 else 0.0)
            if len(points) > 100:
                self._spacing[sensor] = spacing
            kept.append(mine[without_strays(points, origin, spacing)])
        return np.sort(np.concatenate([index[:0], *kept]))

    def _of_body(self, frame: Frame) -> Bool[np.ndarray, " point"]:
        """Which points are assigned to the body as a whole, or to one of so many limbs that it makes no difference."""
        if frame.part is None:
            return np.zeros(len(frame.points), bool)
        present = np.unique(frame.part[frame.part >= 0])
        if len(present) >= 4:
            return frame.part >= 0
        return (frame.part >= 0) & np.array([*(name == "body" for name in frame.parts), False])[frame.part]

    def _choose(self, points, sure) -> Bool[np.ndarray, " point"]:
        """Which points belong to the body. `sure`: those that are known to be on it."""
        if len(points) < 30:
            return np.zeros(len(points), bool)
        label = components(points, self.settings.link)
        count = np.bincount(label)
        most = np.zeros(len(count), bool)
        if len(sure):
            touched = KDTree(sure).query(points, distance_upper_bound=self.settings.link)[0] < np.inf
            touched = np.bincount(label, touched) * (count >= 30)
            most[np.argmax(touched)] = touched.any()
        if self.last is None:
            return most[label] if most.any() else label == self._candidate(points, label, count)
        near = KDTree(self.last).query(points, distance_upper_bound=self.settings.move)[0] < np.inf
        touching = np.bincount(label, near)
        taken = touching > np.maximum(5, 0.3 * count)
        # what stood apart from the body and stays where it is remains apart, however near: a chair;
        # not the body itself, and not what is small: a foot rests while the other one steps
        main = int(np.argmax(touching))
        doubtful = taken & (count >= 0.1 * len(self.last)) & (np.arange(len(count)) != main)
        doubtful[[k for k in np.flatnonzero(doubtful) if self._is_head(points[label == k], points[label == main])]] = 0
        if len(self.others) and doubtful.any():
            asked = doubtful[label]
            still = KDTree(self.others).query(points[asked], distance_upper_bound=STILL)[0] < np.inf
            taken &= ~doubtful | (np.bincount(label[asked], still, len(count)) < 0.6 * count)
        return (most | taken)[label]

    def _is_head(self, thing, body) -> bool:
        """Whether a thing is right above a body: a head whose neck is hidden or narrow, not a chair."""
        floor = self.scene.floor
        apart = np.median(thing, 0) - np.median(body, 0)
        apart -= (apart @ floor.normal) * floor.normal
        return floor.height(thing).min() > 0.6 * self.body_height and bool(np.linalg.norm(apart) < 0.3)

    def _candidate(self, points, label, count) -> int:
        """Label of the thing that is about as high as the body and not much wider, the largest of several; things of
        another height count less. -1 where there is none."""
        height, body = self.scene.floor.height(points), self.body_height
        best, size = -1, 0.0
        for k in np.flatnonzero(count >= 50):
            mine = label == k
            low, top = np.percentile(height[mine], [0.5, 99.5])
            spread = np.ptp(np.percentile(points[mine], [2, 98], axis=0), axis=0)
            tall = self.settings.min_height * body <= top <= 1.35 * body
            likely = count[k] / (1 + ((top - body) / (0.15 * body)) ** 2)
            if tall and low < 0.5 * top and np.linalg.norm(spread) < 1.5 * body and likely > size:
                best, size = int(k), likely
        return best

    def _cells(self, points):
        return np.floor(points / np.float32(0.08)).astype(np.int64)

    def _known(self, points) -> Bool[np.ndarray, " point"]:
        """Whether points lie where something else than the body was seen before."""
        if not self._background:
            return np.zeros(len(points), bool)
        unique, inverse = unique_cells(self._cells(points))
        known = np.array([self._background.get(tuple(c), 0) >= 3 for c in unique.tolist()])
        return known[inverse]

    def _learn(self, others, mine) -> None:
        if self.last is None and not len(mine):
            # nobody there: the room, or somebody who is not told from it yet, so it takes most of a second
            far, times = np.ones(len(others), bool), 0.15
        elif self.last is None or not len(others) or not len(mine):
            return
        else:
            far, times = KDTree(mine).query(others, distance_upper_bound=0.25)[0] == np.inf, 1.0
        for cell in set(map(tuple, self._cells(others[far]).tolist())):
            self._background[cell] = self._background.get(cell, 0.0) + times


def person_frames(frames: Iterable[Frame], finder: PersonFinder) -> Iterator[PersonFrame]:
    """The body's points frame by frame; empty frames where nothing was found."""
    return (finder(frame) for frame in frames)


AWAY = 0.55  # metres from the body's axis: not part of it
BLOCK = 4_000_000  # cells times frames that are compared at once


def without_furniture(frames: list[PersonFrame], up: Float32[np.ndarray, "3"]) -> list[PersonFrame]:
    """Takes out what stayed in its place while the body came or went: furniture that the body touched.

    A cell counts as furniture where points were seen in most of the frames in which the body's axis was more than half
    a metre away, and the axis came closer or went farther by 0.4 m meanwhile. Uses all frames. A body that never leaves
    its place tells nothing, and its frames come back as they are.
    """
    seen = [i for i, f in enumerate(frames) if len(f.points) >= 30]
    if len(seen) < 10:
        return frames
    axis = np.full((len(frames), 3), np.nan, np.float32)
    for i in seen:
        height = frames[i].points @ up
        axis[i] = np.median(frames[i].points[height > np.percentile(height, 60)], 0)
        axis[i] -= (axis[i] @ up) * up
    cells = [unique_cells(np.floor(frames[i].points / np.float32(0.1)).astype(np.int64))[0] for i in seen]
    frame_of = np.repeat(np.arange(len(seen)), [len(c) for c in cells])
    unique, which = unique_cells(np.concatenate(cells))
    middle = (unique + 0.5).astype(np.float32) * np.float32(0.1)
    middle -= (middle @ up)[:, None] * up
    # where it was seen: per occurrence; where it could have been: per cell and frame, in blocks
    distance = np.linalg.norm(middle[which] - axis[seen][frame_of], axis=1)
    seen_away = np.bincount(which, distance > AWAY, len(unique))
    nearest, farthest = np.full(len(unique), np.inf), np.zeros(len(unique))
    np.minimum.at(nearest, which, distance)
    np.maximum.at(farthest, which, distance)
    away = np.zeros(len(unique), int)
    for block in np.array_split(np.array(seen), max(1, len(seen) * len(unique) // BLOCK)):
        away += (np.linalg.norm(middle[:, None] - axis[block][None], axis=2) > AWAY).sum(1)
    share = seen_away / np.maximum(away, 1)
    furniture = unique[(farthest - nearest > 0.4) & (share > 0.5) & (away >= 8)]
    if not len(furniture):
        return frames
    # the cells around too: noise at the faces
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    blocked = set(map(tuple, (furniture[:, None] + around[None]).reshape(-1, 3).tolist()))
    out = []
    for frame in frames:
        cell = np.floor(frame.points / np.float32(0.1)).astype(np.int64).tolist()
        keep = np.array([tuple(c) not in blocked for c in cell], bool)
        out.append(frame.only(keep | assigned(frame)))
    return out
