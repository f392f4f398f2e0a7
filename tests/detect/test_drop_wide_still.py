"""A table before somebody goes; somebody, and what is no wider than they are, stays."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.rooms import FLOOR
from tests.support.still_things import block, sway, table, watched
from voodoo_jax.detect.drop_wide_still import DropWideStill
from voodoo_jax.detect.stillness import Stillness
from voodoo_jax.records.scene import Scene

PERSON = block(0.45, 0.76, 1.75)


def left(frames, *beside: np.ndarray) -> np.ndarray:
    """[frame] How many points are left; `beside` those that were seen beside the body."""
    finder = SimpleNamespace(
        lies=False,
        scene=Scene(FLOOR, (), True),
        beside=lambda: np.concatenate([np.zeros((0, 3)), *beside]).astype(np.float32),
    )
    target: Any = SimpleNamespace(finder=finder, settings=None, stillness=Stillness())
    return np.array([len(f.points) for f in DropWideStill()(iter(frames), target)])


@pytest.mark.parametrize("width, goes", [(1.6, True), (0.6, False)])
def test_a_wide_table_goes_and_the_person_stays(rng, width, goes):
    top = table(width)
    count = left(watched(rng, [(PERSON, sway(0.02)), (top, sway(0.0))]))
    if goes:
        assert (count >= 0.97 * len(PERSON)).all() and (count <= len(PERSON) + 0.05 * len(top)).all()
    else:
        assert (count == len(PERSON) + len(top)).all()


def test_legs_before_a_wide_seat_stay(rng):
    """They are at rest, and hang together with the seat over more than a person's breadth."""
    trunk, legs, seat = block(0.45, 0.76, 1.3), block(0.4, 0.05, 0.45, 2.6), table(1.7, 0.45, 2.65, 3.0)
    frames = watched(rng, [(trunk, sway(0.02)), (legs, sway(0.0)), (seat, sway(0.0))])
    assert (left(frames) >= 0.95 * (len(trunk) + len(legs))).all()


def test_what_is_wide_and_moves_stays(rng):
    spread = block(1.7, 1.3, 1.45)
    assert (left(watched(rng, [(PERSON, sway(0.02)), (spread, sway(0.05))])) == len(PERSON) + len(spread)).all()


def test_nothing_goes_where_nobody_moves_or_for_a_moment(rng):
    things = [(PERSON, sway(0.0)), (table(1.6), sway(0.0))]
    frames = watched(rng, things)
    assert (left(frames) == [len(f.points) for f in frames]).all()
    frames = watched(rng, [(PERSON, sway(0.02)), (table(1.6), sway(0.0))], 10)
    assert (left(frames) == [len(f.points) for f in frames]).all()


@pytest.mark.parametrize("why", ["", "narrow", "high", "few points", "a slice of something high", "the floor"])
def test_the_middle_of_a_counter_goes_where_its_sides_were_seen(rng, why):
    """Something moves behind it, so that it is not known to be at rest, and it is no wider than the body."""
    top = table(1.8, 0.05 if why == "the floor" else 0.9)
    middle = top[np.abs(top[:, 1]) < 0.25]
    sides = top[np.abs(top[:, 1]) > 0.25]
    beside = {
        "narrow": sides[np.abs(sides[:, 1]) < 0.4],
        "high": sides + [0, 0, 0.6],
        "few points": np.concatenate([sides[::8], block(0.4, 0.0, 0.8, 3.0, 1.2), block(0.4, 0.0, 0.8, 3.0, -1.2)]),
        "a slice of something high": np.concatenate([sides + [0, 0, h] for h in np.arange(0, 0.8, 0.08)]),
    }.get(why, sides)
    count = left(watched(rng, [(PERSON, sway(0.02)), (middle, sway(0.02))]), beside)
    if why:
        assert (count == len(PERSON) + len(middle)).all()
    else:
        assert (count <= len(PERSON) + 0.2 * len(middle)).all() and (count >= 0.93 * len(PERSON)).all()
