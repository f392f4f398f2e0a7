"""Floor and walls of a room, as planes, from a few frames. Host side, NumPy."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float32

from voodoo_jax.geometry.plane import MANY, Plane, fit_plane
from voodoo_jax.geometry.voxels import cells_of, touching
from voodoo_jax.records.observation import BodyObservation, assigned, whole
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

BEHIND = 0.25  # metres: what seems to be so far behind a wall is in another room
WIDE, FILLED = 2.0, 1.3  # metres from end to end of a wall that is seen, and of these as high as all of it, at least
SLANTED = 0.9  # cosine: a floor that is so far from where it was thought to be is looked for once more
# cosines: a floor is at most 40 degrees from where up is thought to be, and directions closer than that are taken for
# the same; a wall, or the back of a sofa, is upright to 10 degrees; by hand
STEEPEST, UPRIGHT = 0.77, 0.17
COLUMN = 0.1  # metres
PLACE = 0.05  # metres: what is right above a place on the floor is at most so far, or twice so far, aside


def find_scene(frames: list[Frame], up: Float32[np.ndarray, "3"], up_is_sure: bool = True) -> Scene:
    """Floor and walls from a few frames: `up` need be right to 40 degrees only.

    Where no floor is visible it is taken to be z = 0 of a fixed frame whose z points up (`up_is_sure`; robots' base,
    odometry and map frames are so by convention), or else the height of the lowest points, for the time being.
    """
    rng, up = np.random.default_rng(0), np.asarray(up, np.float32)
    free = [f.only(~assigned(f)) if assigned(f).any() else f for f in map(whole, frames)]
    clouds = [f.points for f in free if len(f.points)]
    points = np.concatenate(clouds) if clouds else np.zeros((0, 3), np.float32)
    if len(points) > MANY:
        points = points[rng.permutation(len(points))[:MANY]]
    if not len(points):  # the person's own lowest points are as near to the floor as one can know
        points = np.concatenate([np.zeros((0, 3), np.float32), *(f.points for f in frames)])
        return Scene(_lowest(points, up, up_is_sure)[0], (), False)
    seen = _find_floor(points, up, rng)
    for cloud in clouds if seen is None and len(clouds) > 1 else []:  # where the sensor moves it is no plane in all
        seen = seen or _find_floor(cloud, up, rng)
    if seen is not None and seen.normal @ up < SLANTED:  # what is near it, and not so far from `up`, was preferred
        again = _find_floor(points, seen.normal, rng)
        seen = again if again is not None and again.normal @ up > STEEPEST else seen
    floor, unknown = (seen, False) if seen else _lowest(points, up, up_is_sure)
    walls: list[Plane] = []
    for frame in free:  # one by one: a person who walks is as wide as a wall over several frames together
        if len(frame.points) and len(walls) < 6:
            walls += _find_walls(frame, floor, walls, rng)
    return Scene(floor, tuple(walls), seen is not None, unknown)


def shows_floor(frame: Frame, up: Float32[np.ndarray, "3"]) -> bool:
    """Whether a floor is seen in a frame if `up` is right to 40 degrees."""
    seen = whole(frame)
    points = seen.points[~assigned(seen)]
    rng = np.random.default_rng(0)
    return _find_floor(points[rng.permutation(len(points))[:20_000]], up, rng) is not None


def _find_walls(frame: BodyObservation, floor: Plane, known: list[Plane], rng) -> list[Plane]:
    """Wide upright planes with nothing behind them."""
    points = frame.points[rng.permutation(len(frame.points))[:20_000]]
    points = points[floor.height(points) > 0.1]
    rest = points
    for wall in known:
        rest = rest[np.abs(wall.height(rest)) > 0.05]
    found: list[Plane] = []
    for _ in range(4):
        fit = fit_plane(rest, lambda n: np.abs(n @ floor.normal) < UPRIGHT, rng, 0.04)
        if fit is None or fit[1].sum() < max(1, 0.08 * len(points)):
            break
        plane, inside = fit
        along = np.cross(floor.normal, plane.normal)
        place = rest[inside] @ along
        wide = np.ptp(np.percentile(place, [2, 98]))
        side = 1 if plane.height(frame.origins[:1])[0] > 0 else -1
        behind = (plane.height(points) * side < -0.15).mean()
        if wide >= WIDE and filled(place, floor.height(rest[inside])) >= FILLED and behind <= 0.03:
            plane = Plane(side * plane.normal, side * plane.offset)
            beyond = -plane.height(points)  # where nothing but noise is
            beyond = beyond[(beyond > 0) & (beyond < BEHIND)]
            found.append(replace(plane, noise=float(np.percentile(beyond, 98)) if len(beyond) else 0.0))
        # else a near person, who may have more points than the wall: look on without them
        rest = rest[~inside]
    return found


def filled(place: Float32[np.ndarray, " point"], height: Float32[np.ndarray, " point"]) -> float:
    """Metres of a plane, along the floor, that are about as high as it is: less where a person and a box beside them
    happen to be in one plane."""
    column, index, count = np.unique(np.floor(place / COLUMN), return_inverse=True, return_counts=True)
    top = np.full(len(column), -np.inf)
    np.maximum.at(top, index, height)
    return COLUMN * float(np.sum((top > 0.6 * np.percentile(height, 98)) & (count >= 3)))


def _find_floor(points, up, rng) -> Plane | None:
    """The floor, if it is seen."""
    if not len(points):
        return None
    height = points @ up
    low = points[height < np.percentile(height, 70)]
    found = fit_plane(low, lambda n: np.abs(n @ up) > STEEPEST, rng, 0.03)
    # least squares turn the plane that was asked for: a chest that leans back is none in the end
    if found is not None and np.abs(found[0].normal @ up) > STEEPEST:
        plane, _ = found
        if plane.normal @ up < 0:
            plane = Plane(-plane.normal, -plane.offset)
        above = plane.height(points)
        # a floor has next to nothing below it, and a fair share of the picture on it
        if (np.abs(above) < 0.03).mean() > 0.04 and (above < -0.1).mean() < 0.03 and _open(points, plane):
            return plane
    return None


def _open(points, plane: Plane) -> bool:
    """Whether most of the points on a plane have nothing right above them, unlike the lower visible edges of walls and
    people."""
    height = plane.height(points)
    place = cells_of(plane.level(points), PLACE)
    above = place[(height > 0.06) & (height < 0.3)]
    return bool(touching(place[np.abs(height) < 0.03], above).mean() < 0.4)


def _lowest(points, up, up_is_sure) -> tuple[Plane, bool]:
    """A substitute for a floor that is not visible, and whether the true floor may be lower."""
    lowest = float(np.percentile(points @ up, 0.5)) if len(points) else 0.0
    known = up_is_sure and -0.2 < lowest < 1.3
    # what is seen farther below z = 0 than a floor is thick (see _find_floor) stands on something lower
    return Plane(up, 0.0 if known and lowest > -0.03 else lowest), not known
