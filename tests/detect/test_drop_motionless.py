"""What never moves is nobody; who stands still and sways by millimetres is somebody."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.rooms import FLOOR
from tests.support.still_things import block, sway, watched
from voodoo_jax.detect.drop_motionless import NOTE, DropMotionless
from voodoo_jax.detect.stillness import Stillness, directions, resting
from voodoo_jax.records.scene import Scene

STAGE = DropMotionless()


def left_of(frames) -> tuple[list[bool], tuple[str, ...]]:
    """In which frames something is left, and what is said."""
    target = SimpleNamespace(
        finder=SimpleNamespace(scene=Scene(FLOOR, (), True), lies=False), settings=None, stillness=Stillness()
    )
    left = list(STAGE(iter(frames), target))
    assert len(left) == len(frames) and [f.time_ns for f in left] == [f.time_ns for f in frames]
    return [len(f.points) > 0 for f in left], target.finder.scene.notes


def dropped(frames) -> tuple[bool, tuple[str, ...]]:
    """Whether nothing is left, and what is said."""
    left, notes = left_of(frames)
    return not any(left), notes


@pytest.mark.parametrize("moving, gone", [(0.0, True), (0.006, False), (0.3, False)])
def test_what_never_moves_goes_and_who_sways_stays(rng, moving, gone):
    frames = watched(rng, [(block(0.45, 0.1, 1.75), sway(moving))])
    assert dropped(frames) == (gone, (NOTE,) if gone else ())


@pytest.mark.parametrize("moving, kept", [(0.0, 40), (0.006, 80)])
def test_who_moves_no_more_than_noise_from_some_frame_on_is_frozen(rng, moving, kept):
    before, after = (watched(rng, [(block(0.45, 0.1, 1.75), sway(by))]) for by in (0.1, moving))
    step = before[1].time_ns - before[0].time_ns
    frames = [replace(f, time_ns=k * step) for k, f in enumerate([*before, *after])]
    left, notes = left_of(frames)
    assert abs(sum(left) - kept) <= 2 and left == sorted(left, reverse=True)
    assert len(notes) == (kept < 80) and NOTE not in notes


def test_noise_alone_is_seldom_taken_for_motion(rng):
    ratios = [directions(watched(rng, [(block(0.45, 0.1, 1.75), sway(0.0))])).ratio for _ in range(5)]
    assert all(np.mean(ratio < 0.6) < 0.05 and abs(np.median(ratio) - 1) < 0.1 for ratio in ratios)


def test_an_arm_that_moves_tells_that_somebody_is_there(rng):
    still, arm = block(0.45, 0.1, 1.75), block(0.4, 1.2, 1.5, middle=0.5)
    assert not dropped(watched(rng, [(still, sway(0.0)), (arm, sway(0.1))]))[0]


def test_nothing_is_decided_in_a_moment_or_by_a_sensor_that_moves(rng):
    frames = watched(rng, [(block(0.45, 0.1, 1.75), sway(0.0))])
    assert not dropped(frames[:19])[0]
    assert not dropped([replace(f, T_fixed_steady=np.eye(4)) for f in frames])[0]
    assert not dropped([replace(f, part=np.zeros(len(f.points), np.int32), parts=("body",)) for f in frames])[0]
    assert dropped(frames)[0]


def test_what_moves_is_found_once_for_the_same_frames(rng):
    frames, one, other = watched(rng, [(block(0.45, 0.1, 1.75), sway(0.006))]), Stillness(), Stillness()
    first = one.directions(frames)
    assert one.directions(list(frames)) is first
    assert other.directions(frames) is not first and one.directions(frames[1:]) is not first
    np.testing.assert_array_equal(other.directions(frames).ratio, first.ratio)


def test_copies_of_a_frame_tell_nothing():
    """A scan that is given again and again: no sensor measures the same noise twice."""
    frame = watched(np.random.default_rng(0), [(block(0.45, 0.1, 1.75), sway(0.0))])[0]
    copies = [replace(frame, time_ns=frame.time_ns + k * 100_000_000) for k in range(60)]
    assert not DropMotionless().is_thing(copies, Stillness())
    assert len(resting(copies).points) == 0
