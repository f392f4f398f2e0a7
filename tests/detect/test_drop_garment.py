"""A skirt goes, and the person in it stays; legs, chairs and boxes beside somebody are none."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.rooms import FLOOR, ORIGIN, grid
from voodoo_jax.detect.drop_garment import DropGarment
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene

TARGET: Any = SimpleNamespace(
    finder=SimpleNamespace(scene=Scene(FLOOR, (), True), lies=False), settings=None, stillness=None
)
NUMBER = 20


def column(ahead: float, aside: float, low: float, high: float, bottom: float, top: float) -> np.ndarray:
    """The side of an upright frustum that the sensor sees, metres before the trunk and beside it; radii."""
    wide = max(bottom, top)
    a = grid((-1.4, 1.4), (low, high), 0.015)
    a = a[rows(a[:, 0], 0.015 / wide)]
    radius = bottom + (top - bottom) * (a[:, 1] - low) / (high - low)
    return np.stack([3 - ahead - radius * np.cos(a[:, 0]), aside + radius * np.sin(a[:, 0]), a[:, 1]], -1)


def rows(angle: np.ndarray, step: float) -> np.ndarray:
    """Which columns of a grid are kept, so that they are about `step` apart."""
    places = np.unique(angle)
    return np.isin(angle, places[:: max(1, round(step / 0.015))])


TRUNK = np.concatenate([column(0, 0, 0.9, 1.5, 0.17, 0.17), column(0, 0, 1.5, 1.75, 0.09, 0.09)])
ARMS = np.concatenate([column(0, y, 0.8, 1.4, 0.04, 0.05) for y in (-0.23, 0.23)])
LEGS = np.concatenate([column(0, y, 0.0, 0.97, 0.05, 0.08) for y in (-0.1, 0.1)])
PERSON = np.concatenate([TRUNK, ARMS, LEGS])
SKIRT = column(0, 0, 0.3, 0.88, 0.32, 0.22)
IN_SKIRT = np.concatenate([TRUNK, LEGS[LEGS[:, 2] < 0.29]])
LAP = np.concatenate([
    column(0, 0, 0.45, 1.0, 0.17, 0.17), column(0, 0, 1.0, 1.3, 0.09, 0.09), *(
        column(a, y, 0.0, 0.5, 0.05, 0.06) for a in (0.45, 0.3) for y in (-0.12, 0.12))
])  # fmt: skip
CHAIR = column(0, 0, 0.0, 0.42, 0.22, 0.22)


def frames(rng, *things: np.ndarray) -> list[BodyObservation]:
    """The things as a sensor with some noise sees them."""
    out = []
    for k in range(NUMBER):
        points = np.concatenate(things)
        points = (points + rng.normal(0, 0.003, points.shape)).astype(np.float32)
        out.append(BodyObservation(k * 33_000_000, points, np.zeros(len(points), np.int32), ORIGIN))
    return out


def left(given: list[BodyObservation]) -> list[BodyObservation]:
    return list(DropGarment()(iter(list(given)), TARGET))


def test_a_skirt_goes_and_the_person_stays(rng):
    given = frames(rng, IN_SKIRT, SKIRT)
    for before, after in zip(given, left(given), strict=True):
        there = {p.tobytes() for p in after.points}
        kept = np.array([p.tobytes() in there for p in before.points])
        assert kept[: len(IN_SKIRT)].mean() > 0.95
        assert kept[len(IN_SKIRT) :].mean() < 0.15  # its hem and its top are in slices with what stays


@pytest.mark.parametrize("why", ["nobody wears one", "it is beside", "it is before", "a chair", "a moment"])
def test_else_all_stays(rng, why):
    things = {
        "nobody wears one": (PERSON,),
        "it is beside": (PERSON, SKIRT + [0, 0.42, 0]),
        "it is before": (PERSON, SKIRT - [0.6, 0, 0]),
        "a chair": (LAP, CHAIR),
    }
    given = frames(rng, *things.get(why, (IN_SKIRT, SKIRT)))
    if why == "a moment":
        given = [*given[:8], *frames(rng, PERSON)]
    assert [len(f.points) for f in left(given)] == [len(f.points) for f in given]


def test_points_that_are_said_to_be_on_the_body_stay(rng):
    given = [
        BodyObservation(f.time_ns, f.points, f.sensor, f.origins, part=np.zeros(len(f.points), np.int32))
        for f in frames(rng, IN_SKIRT, SKIRT)
    ]
    assert [len(f.points) for f in left(given)] == [len(f.points) for f in given]


def test_in_matched_images_legs_are_as_wide_as_a_skirt(rng):
    given = [replace(f, matched=True) for f in frames(rng, IN_SKIRT, SKIRT)]
    assert [len(f.points) for f in left(given)] == [len(f.points) for f in given]
