"""The makings of experiments/rooms: nobody runs into the furniture, and what is found is counted."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from tests.support.rooms import figure
from voodoo_jax.simulate.room import hit_box

ROOT = Path(__file__).parents[2]


@pytest.fixture
def furnished(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    return importlib.import_module("experiments.rooms.furnished")


@pytest.mark.parametrize("seed", range(12))
def test_nobody_runs_into_things_and_none_is_before_them(furnished, seed):
    rng = np.random.default_rng(seed)
    vertices = np.stack([figure(3.0 + 0.05 * k, -0.3 + 0.03 * k) for k in range(20)])
    room = furnished.room_around(vertices, rng)
    points = vertices.reshape(-1, 3)
    assert room.wall is None or room.wall > points[:, 0].max() + 0.1
    for box in room.boxes:
        down = np.tile([1e-6, 1e-6, -1.0], (len(points), 1))
        over = np.isfinite(hit_box(box, points + [0, 0, 5.0], down)[0])  # right above the box
        assert not np.any(over & (points[:, 2] < box.size[2]))
        if box.size[0] < 7.0 and box.x < points[:, 0].max():  # no wall: not before the body's middle
            assert abs(box.y / box.x - np.median(points[:, 1] / points[:, 0])) > 0.25
    assert len(room.boxes) <= 8


def test_what_is_found_and_what_of_it_is_right(furnished):
    person = figure(3.0, 0.0).astype(np.float32)
    chair = person + np.array([0.0, 2.0, 0.0], np.float32)
    half = person[person[:, 2] > 0.9]
    nothing = np.zeros((0, 3), np.float32)
    assert furnished.shares_of([person], [person]) == (1.0, 1.0)
    assert furnished.shares_of([person, person], [person, nothing]) == (0.5, 1.0)
    share, right = furnished.shares_of([person], [np.concatenate([half, chair[: len(half)]])])
    assert 0.45 < share < 0.6 and right == pytest.approx(0.5, abs=0.02)
    assert furnished.shares_of([person], [chair]) == (0.0, 0.0)
