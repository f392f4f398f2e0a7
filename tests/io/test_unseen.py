"""Features that a message has though they were not seen: numbers that stand for that, and places that are held."""

import numpy as np
import pytest

from voodoo_jax.io.landmark_table import Gathered, without_held, without_placeholders

NAMES, COUNT, PERIOD = [f"m{k}" for k in range(8)], 60, 20_000_000


def walking(noise: float = 0.0002) -> np.ndarray:
    """Places [time, marker, 3] of markers that go forward at 1 m/s, metres."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 1.7, (len(NAMES), 3)) + noise * rng.standard_normal((COUNT, len(NAMES), 3))
    places[..., 0] += np.arange(COUNT)[:, None] * PERIOD * 1e-9
    return places


def gathered(places: np.ndarray) -> Gathered:
    times = 10**18 + PERIOD * np.arange(len(places), dtype=np.int64)
    count = places.shape[0] * places.shape[1]
    return Gathered(
        times, tuple(NAMES[: places.shape[1]] * len(places)), ("lab",) * count, np.repeat(times, places.shape[1]),
        places.reshape(count, -1), np.zeros(count),
    )  # fmt: skip


def left(found: Gathered) -> dict[str, int]:
    """How many of each name are left."""
    return {name: found.names.count(name) for name in NAMES}


@pytest.mark.parametrize("number", [0.0, -1.0, 9999.999])
def test_numbers_that_stand_for_not_seen(number):
    places, notes = walking(), []
    places[10:30, 2] = places[50:, 5] = number
    found = without_placeholders("/m", gathered(places), notes)
    assert left(found) == {name: {"m2": 40, "m5": 50}.get(name, COUNT) for name in NAMES}
    assert len(notes) == 1 and "30 features" in notes[0] and "'m2' (20 times)" in notes[0]


def test_one_place_of_many_names_is_none():
    places = walking()
    places[10:20, :4] = (12.5, -3.0, 7.0)
    found = without_placeholders("/m", gathered(places), [])
    assert left(found) == {name: COUNT - 10 * (name in NAMES[:4]) for name in NAMES}


def test_pixels_that_are_alike_by_chance_stay():
    pixels = np.full((COUNT, 3, 2), 100.0)
    pixels[:40, 1] = -1
    found = without_placeholders("/m", gathered(pixels), [])
    assert [found.names.count(name) for name in NAMES[:3]] == [COUNT, 20, COUNT]


def test_what_is_seen_stays():
    """Noise or none; a foot that stands while the others go on; somebody who stands still at the end."""
    for noise in (0.0002, 0.0):
        places, notes = walking(noise), []
        planted = places.copy()
        planted[20:40, 3] = planted[20, 3]
        planted[40:, 3, 0] = planted[20, 3, 0] + np.cumsum(np.minimum(0.01 * np.arange(1, 21), 0.06))
        slow = places.copy()
        slow[..., 0] = 0.5 - 0.5 * np.cos(np.minimum(np.linspace(0, 1.3, COUNT), 1) * np.pi)[:, None]
        slow[46:] = slow[46]
        for some in (places, planted, slow):
            found = gathered(some)
            assert without_held("/m", without_placeholders("/m", found, notes), notes) is found and notes == []


def test_places_that_are_held_until_a_marker_is_seen_again_or_the_log_ends():
    places, notes = walking(), []
    places[11:30, 2], places[41:, 5] = places[10, 2], places[40, 5]
    found = without_held("/m", gathered(places), notes)
    assert left(found) == {name: {"m2": COUNT - 19, "m5": 41}.get(name, COUNT) for name in NAMES}
    assert len(notes) == 1 and "repeat their last visible position" in notes[0]


@pytest.mark.parametrize("until", [35, COUNT])
def test_all_at_once(until):
    """The stream hangs, and goes on or not."""
    places = walking()
    places[20:until] = places[20]
    assert set(left(without_held("/m", gathered(places), [])).values()) == {COUNT - (until - 21)}
