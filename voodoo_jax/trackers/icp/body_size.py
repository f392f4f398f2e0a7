"""Estimates the body's size from the height of the points, and the odds of a stature. Host side."""

import numpy as np
from jaxtyping import Float

from voodoo_jax.config.options import StartSettings
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import point_gap, point_spacing
from voodoo_jax.model.body import Body, rest_height, scaled
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.trackers.shared.confidence import STATURE, STATURES

# logarithms of the odds for each of a logarithm of costs: as the odds of facing had when they were of costs, fitted in
# experiments/trust
TELLS = 19.0
# share of people who are children, and metres between which all statures of children are alike: medians of girls at one
# and a half years and at fourteen (WHO child growth standards, 2006, 0.81, and growth reference, 2007,
# doi:10.2471/BLT.07.043497, 1.60). Measured: CHILDREN times or over 1.5 moves the stature from which on a scale is
# doubted by 2 cm at most (experiments/numbers)
CHILDREN, SMALLEST, GROWN = 0.1, 0.8, 1.6
FEWEST, ABOVE = 50, 1.0045  # points by which a height is measured; of the top over the points' third highest
HEAD_REACH = 0.2  # level distance of the top of a head from the middle of the upper body, metres


def measured_heights(
    frames: list[BodyObservation], floor: Plane, pixel: float | list[float], reach: float = float("inf")
) -> Float[np.ndarray, " frame"]:
    """Height of a standing body from its points in each frame, metres: that of the third highest point; NaN where there
    are too few.

    `reach` level distance in metres from the middle of the upper half within which the top is searched: a hand may be
    higher.

    `pixel` is the angle between neighbouring points, radians, of all sensors or of each: the top lies between the
    highest point and the next.
    """
    heights = np.full(len(frames), np.nan)
    for k, frame in enumerate(frames):
        if len(frame.points) >= FEWEST:
            above = floor.height(frame.points)
            level = floor.level(frame.points)
            middle = np.median(level[above > 0.5 * np.percentile(above, 99)], 0)
            near = np.linalg.norm(level - middle, axis=1) < reach
            if near.sum() < 3:
                continue
            third = np.argsort(np.where(near, above, -np.inf))[-3]
            sensor = int(frame.sensor[third])
            angle = pixel[sensor] if isinstance(pixel, list) else pixel
            heights[k] = above[third] + 1.1 * angle * np.linalg.norm(frame.points[third] - frame.origins[sensor])
    return heights


def _spacings(frames: list[BodyObservation]) -> list[float]:
    """Angle between neighbouring points of each sensor, radians, in its first view of the body; 0 without one. For a
    scanner with sparse rows, half of it: the mean distance of the top above its highest row."""
    found = [0.0] * len(frames[0].origins)
    for sensor in range(len(found)):
        for frame in frames:
            mine = frame.points[frame.sensor == sensor]
            if len(mine) > 4:
                spacing, gap = (of(mine, frame.origins[sensor]) for of in (point_spacing, point_gap))
                found[sensor] = 0.45 * gap if gap > 3 * spacing else spacing
                break
    return found


def stature_density(stature: Float[np.ndarray, " size"], spread: float = STATURES) -> Float[np.ndarray, " size"]:
    """Probability density of statures (metres) of grown people, with a standard deviation of `spread`, and children."""
    small = ((stature > SMALLEST) & (stature < GROWN)) / (GROWN - SMALLEST)
    return (1 - CHILDREN) * normal(stature - STATURE, spread) + CHILDREN * small


def normal(off: Float[np.ndarray, " size"], spread: float) -> Float[np.ndarray, " size"]:
    """Density of a normal distribution."""
    return np.exp(-0.5 * (off / spread) ** 2) / (np.sqrt(2 * np.pi) * spread)


def rarity(body: Body) -> float:
    """Logarithm of the factor on a start's cost for an unusual stature, as its odds say: a body of 2.4 m may explain
    points as well as a smaller one with an arm raised. 0 for other bodies than people's."""
    if body.scale_name != "stature":
        return 0.0
    usual, own = stature_density(np.array([STATURE, float(body.scale)]))
    return float(np.log(usual / own)) / TELLS


def sized(body: Body, frames: list[BodyObservation], floor: Plane, settings: StartSettings) -> Body:
    """The body scaled to the measured size, or to that of the settings."""
    if settings.scale > 0:
        return scaled(body, settings.scale)
    heights = tops(body, frames, floor)
    if not np.isfinite(heights).any():
        return body
    return scaled(body, float(body.scale) * float(np.nanmedian(heights)) / rest_height(body))


def tops(body: Body, frames: list[BodyObservation], floor: Plane) -> Float[np.ndarray, " frame"]:
    """How high the body reaches above the floor in each frame by its points, metres; NaN where there are too few."""
    seen = [f for f in frames if len(f.points) >= FEWEST]
    if not seen:
        return np.full(len(frames), np.nan)
    # a dog's head is not above its middle
    reach = HEAD_REACH if body.scale_name == "stature" else float("inf")
    return ABOVE * measured_heights(frames, floor, _spacings(seen), reach)
