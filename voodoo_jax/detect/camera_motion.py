"""Motion of sensors that no transform reports, estimated from floor and walls. Host side, NumPy.

Registers points to known planes, as in point-to-plane ICP (Chen and Medioni 1992, doi:10.1016/0262-8856(92)90066-C).
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.detect.scene import find_scene
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import fair_share
from voodoo_jax.records.observation import BodyObservation, Seen, with_places
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

ASKED = 1000  # points of a frame
FAR, FASTER = 0.2, 0.6  # metres from a plane, of the points on it at first, and how that changes from step to step
WIDE, FINE = 3.0, 0.005  # times the noise in the end; metres of noise, at least
LEVEL, UPRIGHT = 0.03, 0.07  # metres of noise of floors and walls, at first
STEPS = 15
CALM, EVERY = 30, 3  # frames without motion after which only every third is tested
SETTLED = 0.0005  # metres
SHAKEN = 0.015  # metres, root mean square, by which the planes seem to have moved: less is noise
NOISY = 0.4  # of the planes' noise: an increase by that share is noise in any case
COUNT = 100  # weight of all points together, as a number of measurements: their errors are correlated
STIFF = np.array([0.02, 0.02, 0.02, 0.03, 0.03, 0.03])  # radians and metres from frame to frame: what nothing tells
FORGET = 0.98  # factor from frame to frame on the estimated motion where no plane determines it
FEWEST = 0.05  # of the points are on planes: with fewer the motion is unknown
STILL = np.eye(4)
TIMES = 2  # repetitions of finding floor and walls after removing the motion
ALIKE = 0.05, 0.15  # radians and metres: one wall, found twice for its noise


class Planes(NamedTuple):
    """Planes that do not move."""

    normals: Float64[np.ndarray, "plane 3"]
    offsets: Float64[np.ndarray, " plane"]  # metres
    noise: Float64[np.ndarray, " plane"]  # standard deviation, metres

    @classmethod
    def of(cls, scene: Scene, frames: list[Frame]) -> "Planes":
        """Floor and walls, from the frame that shows most of them."""
        known: list[Plane] = [scene.floor] if scene.floor_seen else []
        for wall in scene.walls:
            if not any(_alike(wall, plane) for plane in known):
                known.append(wall)
        if not known:
            return cls(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
        normals = np.array([plane.normal for plane in known], float)
        offsets = np.array([plane.offset for plane in known], float)
        noise = np.array([LEVEL if plane is scene.floor else UPRIGHT for plane in known])
        points = max((_some(frame) for frame in frames), key=len, default=np.zeros((0, 3)))
        for _ in range(3):
            off, which = _off(points, normals, offsets)
            for k in range(len(known)):
                mine = off[(which == k) & (np.abs(off) < max(WIDE * noise[k], 0.05))]
                if len(mine):
                    offsets[k] += np.median(mine)
                    noise[k] = max(1.5 * float(np.median(np.abs(mine - np.median(mine)))), FINE)
        off, which = _off(points, normals, offsets)
        share = np.bincount(which[np.abs(off) < WIDE * noise[which]], minlength=len(known)) / max(len(points), 1)
        good = (share > FEWEST) & (np.abs(offsets - [plane.offset for plane in known]) < ALIKE[1])
        return cls(normals[good], offsets[good], noise[good])


def steady_scene(
    frames: list[Frame], up: Float32[np.ndarray, "3"], up_is_sure: bool = True, every: int = 3
) -> tuple[Scene, Planes]:
    """Floor and walls from successive frames (subsampled) in which sensors may move, see scene.find_scene; and the
    state that steadies these and later frames."""
    scene = find_scene(frames[::every], up, up_is_sure)
    planes = Planes.of(scene, frames[::every])
    for _ in range(TIMES):
        steady = list(steadied(frames, planes))
        if all(frame.T_fixed_steady is None for frame in steady):
            break
        scene = find_scene(steady[::every], up, up_is_sure)
        planes = Planes.of(scene, steady[::every])
    return scene, planes


def _alike(one: Plane, other: Plane) -> bool:
    return bool(one.normal @ other.normal > np.cos(ALIKE[0]) and abs(one.offset - other.offset) < ALIKE[1])


def _some(frame: Frame) -> Float64[np.ndarray, "point 3"]:
    return frame.points[fair_share(frame.sensor, ASKED)].astype(float)


def _off(points, normals, offsets) -> tuple[Float64[np.ndarray, " point"], Int[np.ndarray, " point"]]:
    """Distances of points from the nearest plane, and its index."""
    off = points @ normals.T - offsets
    which = np.argmin(np.abs(off), 1)
    return off[np.arange(len(off)), which], which


def steadied(frames: Iterable[Frame], planes: Planes) -> Iterator[Frame]:
    """The frames as if all sensors had kept the pose in which floor and walls were found; uses no later frames.

    Motion along a plane and about its normal is unknown if there is no other plane, and is not corrected.
    """
    T, calm = STILL, 0  # frames since they moved
    for frame in frames:
        calm = calm + 1 if T is STILL else 0
        # who holds a camera never stands still for so long
        asked = calm < CALM or calm % EVERY == 0
        if asked and len(planes.offsets) and len(frame.points):
            T = _found(_some(frame), frame.origins.mean(0).astype(float), planes, T)
        yield frame if T is STILL else replace(_placed(frame, T), T_fixed_steady=np.linalg.inv(T))


def _found(
    points: Float64[np.ndarray, "point 3"],
    origin: Float64[np.ndarray, "3"],
    planes: Planes,
    start: Float64[np.ndarray, "4 4"],
) -> Float64[np.ndarray, "4 4"]:
    """The transform that moves the points onto the planes, beginning with `start`: the identity without motion."""
    still = start is STILL
    if still and not _moving(points[::2], origin, planes):
        return start
    if not still:
        start = turned(FORGET * np.concatenate([Rotation.from_matrix(start[:3, :3]).as_rotvec(), start[:3, 3]]))
    T, whole, reach = start, np.zeros(6), FAR
    pivot = moved(origin[None], T)[0]
    for _ in range(STEPS):
        there = moved(points, T)
        off, which = _off(there, planes.normals, planes.offsets)
        least = WIDE * planes.noise[which]
        limit = np.maximum(reach, least)
        near = np.abs(off) < limit
        if near.mean() < FEWEST:
            return start
        off, normal, noise, limit = off[near], planes.normals[which[near]], planes.noise[which[near]], limit[near]
        x, jacobian, weight = onto_planes(there[near] - pivot, normal, off, noise, limit, whole)
        whole = whole + x
        T = turned(whole, pivot) @ start
        shift = np.sum(normal * (moved(points[near], T) - points[near]), 1)
        toward = np.sqrt(np.sum(weight * shift**2) / weight.sum())
        if (limit <= least[near]).all() and np.abs(jacobian @ x).max() < SETTLED:
            break
        reach *= FASTER
    return T if toward > max(SHAKEN, NOISY * float(np.sqrt(np.average(noise**2, weights=weight)))) else STILL


def _moving(points: Float64[np.ndarray, "point 3"], origin: Float64[np.ndarray, "3"], planes: Planes) -> bool:
    """Whether, by a first step, static sensors may have moved."""
    off, which = _off(points, planes.normals, planes.offsets)
    limit = np.maximum(FAR, WIDE * planes.noise)[which]
    near = np.flatnonzero(np.abs(off) < limit)
    if len(near) < FEWEST * len(points):
        return False
    which = which[near]
    x, jacobian, weight = onto_planes(
        points[near] - origin, planes.normals[which], off[near], planes.noise[which], limit[near], np.zeros(6)
    )
    return bool(weight @ (jacobian @ x) ** 2 >= (SHAKEN / 2) ** 2 * weight.sum())


def onto_planes(
    arms: Float64[np.ndarray, "point 3"],
    normal: Float64[np.ndarray, "point 3"],
    off: Float64[np.ndarray, " point"],
    noise: Float64[np.ndarray, " point"],
    limit: Float64[np.ndarray, " point"],
    whole: Float64[np.ndarray, "6"],
) -> tuple[Float64[np.ndarray, "6"], Float64[np.ndarray, "point 6"], Float64[np.ndarray, " point"]]:
    """Rotation and translation about a pivot that reduce the distances `off` of points from planes; the Jacobian and
    the weights of the points. `whole`: the motion so far."""
    weight = (1 - (off / limit) ** 2) ** 2
    weight *= COUNT / weight.sum() / noise**2
    (ax, ay, az), (nx, ny, nz) = arms.T, normal.T
    jacobian = np.stack([ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx, nx, ny, nz])
    weighted = jacobian * weight
    x = np.linalg.solve(weighted @ jacobian.T + np.diag(STIFF**-2.0), -weighted @ off - whole / STIFF**2)
    return x, jacobian.T, weight


def turned(x: Float64[np.ndarray, "6"], pivot: Float64[np.ndarray, "3"] | float = 0.0) -> Float64[np.ndarray, "4 4"]:
    """A rotation about a point, and a translation."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(x[:3]).as_matrix()
    T[:3, 3] = x[3:] + pivot - T[:3, :3] @ (pivot + np.zeros(3))
    return T


def moved(points: Float[np.ndarray, "point 3"], T: Float64[np.ndarray, "4 4"]) -> Float[np.ndarray, "point 3"]:
    return points @ T[:3, :3].T + T[:3, 3]


def _placed(frame: Seen, T: Float64[np.ndarray, "4 4"]) -> Seen:
    """The frame with all its measurements transformed."""
    return with_places(frame, lambda p: moved(p, T).astype(np.float32), lambda v: (v @ T[:3, :3].T).astype(np.float32))


def as_measured(frame: BodyObservation) -> BodyObservation:
    """The frame with all its measurements in the fixed frame."""
    T = frame.T_fixed_steady
    return frame if T is None else replace(_placed(frame, T), T_fixed_steady=None)


def to_fixed(people: list[BodyObservation], rotation: np.ndarray, translation: np.ndarray) -> None:
    """Moves limbs' poses (quaternions wxyz [frame, limb, 4], places [frame, limb, 3]) to the fixed frame, in place."""
    for k, frame in enumerate(people):
        T = frame.T_fixed_steady
        there = np.isfinite(translation[k]).all(1)
        if T is not None and there.any():
            turned = Rotation.from_matrix(T[:3, :3]) * Rotation.from_quat(rotation[k, there], scalar_first=True)
            rotation[k, there] = turned.as_quat(scalar_first=True)
            translation[k, there] = moved(translation[k, there], T)
