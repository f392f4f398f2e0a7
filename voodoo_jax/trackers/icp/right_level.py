"""Estimates whether the fixed frame of a log is level, by its visible floor. Host side, NumPy.

The body is found by the floor, so that it is right in the log's own frame, however that is rotated. But if transforms
give the mounting of the sensor, a sloping visible floor means that either they are wrong, or the floor is a slope. If
they are wrong, so are all positions: 12 degrees are 60 cm at 3 m. Bayes' rule gives the odds.
"""

from typing import NamedTuple

import numpy as np

from voodoo_jax.config.options import Settings
from voodoo_jax.detect.scene import STEEPEST
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.trackers.icp.right_scale import ENOUGH

# degrees, standard deviation of both angles of a level floor; measured: up to 0.6 in recordings and cases, 1.1 on a car
LEVEL = 1.0
# share of logs on a slope, and standard deviation of its angles, degrees; the same of mounts that transforms turn
# wrongly. Measured (experiments/numbers): each times or over 1.5 moves the 3.45 degrees from which on a fixed frame is
# doubted by 0.35 at most
SLOPES, SLOPE, WRONG, SPREAD = 0.03, 4.0, 0.05, 8.0


class Level(NamedTuple):
    """Estimates about the level of a fixed frame."""

    right: float = 1.0  # probability that transforms turn the sensor rightly, 0..1; 1 where there is hardly a doubt
    degrees: float = 0.0  # from the floor's normal to its z-axis


NO_DOUBT = Level()


def level_of(scene: Scene, people: list[BodyObservation], settings: Settings) -> Level:
    """Estimates about the fixed frame, whose z-axis points up: none if the user stated it, if no transform places the
    sensor, or if sensors were found to move."""
    origins = [frame.origins for frame in people[:1]]
    # a sensor in the frame's origin is the frame, which need not stand level
    mounted = bool(origins) and bool(np.any(origins[0]))
    moved = any(frame.T_fixed_steady is not None for frame in people)
    if not scene.floor_seen or not mounted or moved or settings.read.up:
        return NO_DOUBT
    return level_odds(float(np.degrees(np.arccos(np.clip(scene.floor.normal[2], -1.0, 1.0)))))


def level_odds(degrees: float) -> Level:
    """Estimates about a fixed frame in which the floor slopes by an angle in degrees; a model of two normal
    distributions. Where it is steeper than a floor may be, up is another axis."""
    density = lambda spread: np.exp(-0.5 * (degrees / spread) ** 2) / spread**2  # noqa: E731
    right = (1 - WRONG) * ((1 - SLOPES) * density(LEVEL) + SLOPES * density(SLOPE))
    sure = float(right / (right + WRONG * density(SPREAD)))
    return NO_DOUBT if sure >= ENOUGH or np.cos(np.radians(degrees)) < STEEPEST else Level(sure, degrees)
