"""Removes flat faces of furniture that the body touches all the time: seats, backs, fronts of sofas, tables. People are
not flat to some millimetres. Host side, NumPy; looks ahead."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from voodoo_jax.detect.stage import Target, WindowStage
from voodoo_jax.detect.stillness import Resting, resting
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.observation import BodyObservation, assigned

NEIGHBOURS, NEAR = 20, (0.06, 3.0)  # by which a normal is found: how many at most, within metres and pixels
EVEN = 0.006  # metres from the plane of its neighbours (root mean square): a point is on something even
ON, ALIKE = 0.008, np.cos(np.radians(20))  # metres from a face, and cosine of its normal's angle: a point is on it
TRIED, MOST = 100, 8  # planes that are tried for a face, and faces that are looked for
AREA, LONG, BROAD = 0.03, 0.2, 0.08  # square metres, and metres, of a face at least
FLAT, FLATTER = 0.003, 0.0022  # metres from the plane (root mean square): of a face, and of one that is nothing else
FILLED = 0.8  # of its rectangle: so much of a face that is not so flat is seen
UPRIGHT, LEVEL = 0.03, 0.995  # vertical component of its normal at most, or at least
STANDS = 0.15  # metres above the floor, at most, where what stands on it ends
SMALL = 8  # points of a face, at least
BEHIND = 2.5  # times the noise, from a face: so far its points are
ASIDE = 0.045  # metres beyond its outline


@dataclass(frozen=True)
class Face:
    """A flat piece of furniture."""

    normal: Float[np.ndarray, "3"]
    middle: Float[np.ndarray, "3"]
    points: Float[np.ndarray, "point 3"]

    @cached_property
    def tree(self) -> KDTree:
        return KDTree(self.points)

    def holds(self, points: Float[np.ndarray, "any 3"], off: float) -> Bool[np.ndarray, " any"]:
        """Which points are on it, or less than `off` metres away from its plane."""
        height = (points - self.middle) @ self.normal
        found = np.abs(height) < off
        level = points[found] - height[found, None] * self.normal
        found[found] = self.tree.query(level, distance_upper_bound=ASIDE)[0] < np.inf
        return found


@dataclass(frozen=True)
class DropPlanarFurniture(WindowStage):
    """Removes flat faces that the body touches all the time; for people only, since a machine may have flat faces."""

    name: ClassVar = "drop_planar_furniture"

    def change(self, window: list[BodyObservation], target: Target) -> list[BodyObservation]:
        return without_faces(window, target.finder.scene.floor)


def without_faces(frames: list[BodyObservation], floor: Plane) -> list[BodyObservation]:
    """The frames without points on flat faces at rest; the same frames if there are none."""
    faces = flat_faces(resting(frames), floor)
    if not faces:
        return frames
    off = max(0.02, BEHIND * float(np.median([f.noise for f in frames if len(f.points)])))
    out = []
    for frame in frames:
        on = np.zeros(len(frame.points), bool)
        for face in faces:
            on |= face.holds(frame.points, off)
        out.append(frame.only(~on | assigned(frame)) if on.any() else frame)
    return out


def flat_faces(rest: Resting, floor: Plane) -> list[Face]:
    """Faces of furniture, the largest ones first."""
    patches = _even_patches(rest) if len(rest.points) >= 50 else ()
    return [face for face, area in patches if _is_furniture(face, area, floor)]


def _is_furniture(face: Face, area: float, floor: Plane) -> bool:
    across = np.linalg.svd(face.points - face.middle, full_matrices=False)[2][:2]
    long, broad = np.subtract(*np.percentile((face.points - face.middle) @ across.T, [97, 3], axis=0))
    rough = float(np.std((face.points - face.middle) @ face.normal))
    up = abs(face.normal @ floor.normal)
    if area < AREA or long < LONG or broad < BROAD or UPRIGHT < up < LEVEL:
        return False
    filled = area > FILLED * long * broad
    stands = np.percentile(floor.height(face.points.astype(np.float32)), 2) < STANDS
    return bool(rough < FLATTER or (rough < FLAT and filled and (stands or up > LEVEL)))


def _even_patches(rest: Resting) -> list[tuple[Face, float]]:
    """Planar pieces among the static points, and their areas, square metres; the largest first."""
    normal, even = _normals(rest)
    slant = np.maximum(np.abs(np.sum(normal * rest.direction, 1)), 0.2)
    area = rest.pixel**2 / slant
    link = 3.2 * float(np.median(rest.pixel))
    found: list[tuple[Face, float]] = []
    left = np.flatnonzero(even)
    while len(left) >= SMALL and len(found) < MOST:
        points, mine = rest.points[left], normal[left]
        tried = np.arange(len(left))[:: len(left) // TRIED + 1]
        on = np.abs(points @ mine[tried].T - np.sum(points[tried] * mine[tried], 1)) < ON
        on &= np.abs(mine @ mine[tried].T) > ALIKE
        best = int(tried[np.argmax(area[left] @ on)])
        face = _settled(points, mine, best)
        if len(face) < SMALL:
            left = np.delete(left, best)
            continue
        pairs = KDTree(points[face]).query_pairs(link, output_type="ndarray")
        linked = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(len(face),) * 2)
        label = connected_components(linked, directed=False)[1]
        face = face[label == np.argmax(np.bincount(label, area[left[face]]))]
        if len(face) >= SMALL:
            found.append((_face(points[face]), float(area[left[face]].sum())))
        left = np.delete(left, face)
    return found


def _settled(points: np.ndarray, normal: np.ndarray, best: int) -> Int[np.ndarray, " inlier"]:
    """The points on the plane through one of them, with the plane refitted to them."""
    plane, on = Face(normal[best], points[best], points[:0]), np.zeros(0, int)
    for _ in range(3):
        on = np.flatnonzero(
            (np.abs((points - plane.middle) @ plane.normal) < ON) & (np.abs(normal @ plane.normal) > ALIKE)
        )
        if len(on) < SMALL:
            break
        plane = _face(points[on])
    return on


def _face(points: np.ndarray) -> Face:
    middle = points.mean(0)
    return Face(np.linalg.eigh((points - middle).T @ (points - middle))[1][:, 0], middle, points)


def _normals(rest: Resting) -> tuple[Float[np.ndarray, "rest 3"], Bool[np.ndarray, " rest"]]:
    """Normals of the surface at each point, and whether it is flat there."""
    reach = max(NEAR[0], NEAR[1] * float(np.median(rest.pixel)))
    distance, index = KDTree(rest.points).query(rest.points, NEIGHBOURS, distance_upper_bound=reach)
    there = np.isfinite(distance)
    near = rest.points[np.where(there, index, 0)] * there[..., None]
    count = there.sum(1)
    near = (near - (near.sum(1) / count[:, None])[:, None]) * there[..., None]
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near) / count[:, None, None])
    spread = np.sqrt(np.maximum(spread, 0))
    return axes[:, :, 0], (count >= 6) & (spread[:, 0] < EVEN) & (spread[:, 1] > 0.2 * reach)
