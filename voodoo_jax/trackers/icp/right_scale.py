"""Estimates whether the distances of a log have the right scale, by the stature of a person and the height of the
sensor above the floor. Host side, NumPy.

A body determines its proportions, but no scale: with all distances 1.2 times too large it fits as well, and every joint
is right in the log's distances. A power of ten is found when a log is read (detect/units.py). Other factors leave two
explanations of an unusual stature, an unusual person and an unusual scale; Bayes' rule over all factors gives their
odds. If transforms give the height of the sensor, the floor is evidence, too: with a sensor at 1.25 m and distances 1.2
times too large it appears at -0.25 m. Then either the scale is wrong, or the fixed frame is not on the floor, such as
that of a robot's body.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.trackers.icp.body_size import normal, stature_density
from voodoo_jax.trackers.shared.confidence import STATURES

FOUND = 0.03  # metres: standard deviation of the stature that is found; measured: 2 cm in the 18 recordings
# share of logs whose scale is wrong, and standard deviation of its logarithm; share
# of fixed frames that stand on the floor, where transforms say how high the sensor is, how exactly it is seen there
# (metres: 7 mm off in the recordings), and how far off other frames are; a probability of a right scale that is worth
# no word, and no doubt. Measured (experiments/numbers): each times or over 1.5 moves the 1.98 m from which on a scale
# is doubted by 2 cm at most (ENOUGH 0.57: 5), which is less than FOUND
WRONG, SPREAD, STANDS, LEVEL, ELSEWHERE, ENOUGH = 0.02, 0.25, 0.7, 0.03, 0.3, 0.85
FACTORS = np.exp(SPREAD * np.linspace(-4, 4, 401))  # of larger ones detect/units.py knows


class Scale(NamedTuple):
    """Estimates about the scale of a log."""

    right: float  # probability that it is, 0..1; 1 where there is hardly a doubt
    factor: float  # if it is not, distances are most likely so many times too large


NO_DOUBT = Scale(1.0, 1.0)


def scale_of(body: Body, scene: Scene, people: list[BodyObservation], settings: Settings) -> Scale:
    """Estimates about the scale of a log by the size of its main body: none if the user stated the scale or the
    stature."""
    given = settings.start.scale > 0 or bool(settings.read.scale)
    if given or not people or body.scale_name != "stature":
        return NO_DOUBT
    sensor = float(np.median(people[0].origins @ scene.floor.normal))
    # without a floor in view it is where it should be, unless something lies lower
    seen = scene.floor_seen or scene.floor.offset != 0
    return scale_odds(float(body.scale), *((sensor, float(scene.floor.offset)) if seen else ()))


def scale_odds(stature: float, sensor: float = 0.0, floor: float = 0.0) -> Scale:
    """Estimates about the scale of a log in which a person has a stature (metres).

    **Arguments:** `sensor` height in the fixed frame by the log's transforms, and `floor` measured height of the floor,
    both along its normal, metres; 0 if unknown.
    """
    prior = np.exp(-0.5 * (np.log(FACTORS) / SPREAD) ** 2)
    each = WRONG * prior / prior.sum() * _likelihood(FACTORS, stature, sensor, floor)
    right, wrong = (1 - WRONG) * float(_likelihood(np.ones(1), stature, sensor, floor)[0]), float(each.sum())
    if right >= ENOUGH * (right + wrong):
        return NO_DOUBT
    return Scale(right / (right + wrong), float(FACTORS[each.argmax()]))


def _likelihood(
    factor: Float[np.ndarray, " factor"], stature: float, sensor: float, floor: float
) -> Float[np.ndarray, " factor"]:
    """Density of a stature and of the floor's height for a factor on distances."""
    off = floor - sensor * (1 - factor)
    height = STANDS * normal(off, LEVEL) + (1 - STANDS) * normal(off, ELSEWHERE)
    return stature_density(stature / factor, float(np.hypot(STATURES, FOUND))) / factor * height
