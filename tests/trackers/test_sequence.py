"""Long segments: spans that are refined while later ones are tracked, and what follows where one begins otherwise."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.scan import Step, at_rest
from voodoo_jax.storage import cores
from voodoo_jax.trackers.shared import sequence
from voodoo_jax.trackers.shared.runner import FrameRunner
from voodoo_jax.trackers.shared.segment import Followed
from voodoo_jax.trackers.shared.sequence import KnownStart, Method, follow

FRAMES = 30


def poses_at(place: float) -> Poses:
    return Poses(np.array([[1, 0, 0, 0]], np.float32), np.array([[place, 0, 0]], np.float32))


class Counting(FrameRunner):
    """A runner whose one limb is a metre farther in each frame."""

    def __init__(self):
        self.settings, self.people = Settings(), [None] * FRAMES
        self.others, self.named, self.featured = [], np.zeros(FRAMES, bool), np.zeros(FRAMES, bool)
        self.doubt = False

    def can_start(self, at):
        return True

    def change(self, at, state):
        return state

    def chunk(self, state, at, most):
        count = min(most, 4, FRAMES - at)
        place = state.poses.translation[0, 0] + 1 + np.arange(count, dtype=np.float32)
        translation = np.stack([place, 0 * place, 0 * place], -1)[:, None]
        zero, one = np.zeros(count, np.float32), np.ones((count, 1), np.float32)
        rotation = np.broadcast_to(np.array([1, 0, 0, 0], np.float32), (count, 1, 4))
        many = np.full(count, 100, np.int32)
        of_frames = (zero, zero + 1, zero, one, many, many, np.zeros((count, 1, 6, 6)))
        step = Step(Poses(rotation, translation), *map(jnp.asarray, of_frames))
        return at_rest(poses_at(float(place[-1]))), step, count


class Marking(Method):
    """Refinement adds 0.5 m to the height of all frames; from the span on that begins in `turned` another start took
    over, 1000 m farther."""

    def __init__(self, turned: int):
        self.turned, self.spans = turned, []

    def begin(self, run, at, before):
        return KnownStart(at, poses_at(-1.0))

    def refines(self, run):
        return True

    def refine(self, run, segment: Followed) -> Followed:
        self.spans.append((segment.first, segment.end))
        place = segment.translation + np.array([0, 0, 0.5], np.float32)
        if segment.first != self.turned or segment.translation[0, 0, 0] > 1000:
            return replace(segment, translation=place)
        place = place + np.array([1000, 0, 0], np.float32)
        return replace(segment, translation=place, state=at_rest(poses_at(float(place[-1, 0, 0]))))


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("turned", [-1, 0, 6, 14, 22])
def test_spans_are_as_if_one_waited_for_the_other(monkeypatch, count, turned):
    monkeypatch.setattr(cores, "own_cores", lambda: count)
    monkeypatch.setattr(sequence, "SPAN", 8)
    monkeypatch.setattr(sequence, "OVERLAP", 2)
    run, method, out = Counting(), Marking(turned), Followed.blank(FRAMES, 1)
    follow(run, 0, np.ones(FRAMES, bool), out, method, None)
    assert np.all(out.status == Status.TRACKED)
    farther = 1000.0 * (np.arange(FRAMES) >= turned) * (turned >= 0)
    np.testing.assert_array_equal(out.translation[:, 0, 0], np.arange(FRAMES) + farther)
    assert np.all(out.translation[:, 0, 2] >= 0.5)  # every frame was refined
    assert method.spans[0] == (0, 8) and method.spans[-1][1] == FRAMES
