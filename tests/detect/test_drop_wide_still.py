"""A table before somebody goes; somebody, and what is no wider than they are, stays."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.rooms import FLOOR
from tests.support.still_things import block, sway, table, watched
from voodoo_jax.detect.drop_wide_still import DropWideStill
from voodoo_jax.detect.stillness import Stillness
from voodoo_jax.records.scene import Scene

PERSON = block(0.45, 0.76, 1.75)
TARGET = SimpleNamespace(finder=SimpleNamespace(scene=Scene(FLOOR, (), True)), settings=None, stillness=Stillness())


def left(frames) -> np.ndarray:
    """[frame] How many points are left."""
    return np.array([len(f.points) for f in DropWideStill()(iter(frames), TARGET)])


@pytest.mark.parametrize("width, goes", [(1.6, True), (0.6, False)])
def test_a_wide_table_goes_and_the_person_stays(rng, width, goes):
    top = table(width)
    count = left(watched(rng, [(PERSON, sway(0.02)), (top, sway(0.0))]))
    if goes:
        assert (count >= 0.97 * len(PERSON)).all() and (count <= len(PERSON) + 0.05 * len(top)).all()
    else:
        assert (count == len(PERSON) + len(top)).all()


def test_what_is_wide_and_moves_stays(rng):
    spread = block(1.7, 1.3, 1.45)
    assert (left(watched(rng, [(PERSON, sway(0.02)), (spread, sway(0.05))])) == len(PERSON) + len(spread)).all()


def test_nothing_goes_where_nobody_moves_or_for_a_moment(rng):
    things = [(PERSON, sway(0.0)), (table(1.6), sway(0.0))]
    frames = watched(rng, things)
    assert (left(frames) == [len(f.points) for f in frames]).all()
    frames = watched(rng, [(PERSON, sway(0.02)), (table(1.6), sway(0.0))], 10)
    assert (left(frames) == [len(f.points) for f in frames]).all()
