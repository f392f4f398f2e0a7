"""Ragged frames to fixed shapes, and what the scan over frames makes of them."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import SOLVE, TWO_LIMBS_SENSOR, all_finite, two_limb_frames, two_limbs
from voodoo_jax.config.options import TrackSettings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.solve.padding import BUCKETS, bucket, pad_frames
from voodoo_jax.solve.scan import NOBODY, Visits, at_rest, options_from, track_chunk, track_visits


def test_bucket():
    assert [bucket(n) for n in (0, 1, 256, 257, 8192, 10**6)] == [256, 256, 256, 512, 8192, 8192]
    assert list(BUCKETS) == sorted(BUCKETS)


def test_padding_is_harmless_and_thinning_repeatable():
    given = two_limb_frames([300, 0, 40])
    chunk = pad_frames(given, 64, 5, None, 1)
    np.testing.assert_array_equal(chunk.points.weight.sum(-1), [64, 0, 40, 0, 0])
    np.testing.assert_array_equal(chunk.valid, [True, True, True, False, False])
    np.testing.assert_allclose(chunk.seconds, [0, 0.033, 0.033, 0, 0], atol=1e-6)
    assert chunk.left_out == 300 - 64 and all_finite(chunk.points)
    np.testing.assert_array_equal(chunk.points.xyz[2, 40:], np.broadcast_to(TWO_LIMBS_SENSOR, (24, 3)))
    assert len(np.unique(chunk.points.xyz[0], axis=0)) == 64  # thinned without repetition
    # the choice does not depend on where a recording is cut
    later = pad_frames(given[:1], 64, 1, given[0].time_ns - 33_000_000, 1)
    np.testing.assert_array_equal(later.points.xyz[0], chunk.points.xyz[0])
    np.testing.assert_allclose(later.seconds, [0.033], atol=1e-6)


@pytest.fixture(scope="module")
def compiled():
    """Traces are counted: the test fails when there is a second one."""
    return eqx.filter_jit(eqx.debug.assert_max_traces(track_chunk, max_traces=1))


def run(compiled, counts, length, **changes):
    body = two_limbs()
    options = options_from(replace(SOLVE, **changes), TrackSettings(damping=changes.get("ratio", 0.5)))
    chunk = pad_frames(two_limb_frames(counts), 256, length, 10**18 - 33_000_000, 1)
    return compiled(
        body, options, at_rest(body.rest), chunk.points, jnp.asarray(chunk.seconds), jnp.asarray(chunk.valid)
    )


def test_one_trace_for_a_bucket_whatever_the_numbers(compiled):
    first, steps = run(compiled, [200, 150, 100], 4)
    other, _ = run(compiled, [250, 20], 4, ratio=0.3, max_steps=3, epsilon=1e-4, prior=0.01, robust_scale=0.05)
    assert all_finite((first, steps, other))
    assert not np.array_equal(first.poses.translation, other.poses.translation)


def test_padded_frames_leave_the_state_alone(compiled):
    padded, steps = run(compiled, [200, 150], 4)
    full, _ = run(compiled, [200, 150, 150, 150], 4)
    np.testing.assert_array_equal(steps.points, [200, 150, 0, 0])
    np.testing.assert_array_equal(steps.poses.translation[1], padded.poses.translation)
    assert not np.array_equal(full.poses.translation, padded.poses.translation)


def test_a_frame_without_points_keeps_the_prediction(compiled):
    state, steps = run(compiled, [200, 0, 200], 4)
    np.testing.assert_array_equal(steps.points, [200, 0, 200, 0])
    assert all_finite(jax.tree.leaves(state)) and all_finite(steps)
    assert steps.explained[1] == 0 and steps.explained[2] > 0.9


def test_tracks_that_take_turns_do_not_know_of_each_other():
    """Two starts in one scan, in turns and with nobody's in between, and each alone: the same to the last digit."""
    body, options = two_limbs(), options_from(SOLVE, TrackSettings())
    chunk = pad_frames(two_limb_frames([200, 150, 100, 0]), 256, 4, 10**18 - 33_000_000, 1)
    starts = [body.rest, Poses(body.rest.rotation, body.rest.translation + jnp.float32(0.02))]
    both = jax.tree.map(lambda *x: jnp.stack(x), *map(at_rest, starts))
    visits = Visits(np.array([0, 0, 2, 1, 1, 0, 2]), np.array([0, 1, NOBODY, 1, 0, NOBODY, 0]))
    states, steps = track_visits(body, options, both, chunk.points, chunk.seconds, visits)
    rows = {0: [0, 4, 6], 1: [1, 3]}
    for track, mine in rows.items():
        own = visits._replace(track=np.where(visits.track == track, track, NOBODY))
        state, alone = track_visits(body, options, both, chunk.points, chunk.seconds, own)
        for one, other in zip(jax.tree.leaves(state), jax.tree.leaves(states)):
            np.testing.assert_array_equal(one[track], other[track])
        for one, other in zip(jax.tree.leaves(alone), jax.tree.leaves(steps)):
            np.testing.assert_array_equal(np.asarray(one)[mine], np.asarray(other)[mine])
        # another program, so the last digits are others
        valid = np.arange(4) < len(mine)
        last, consecutive = track_chunk(body, options, at_rest(starts[track]), chunk.points, chunk.seconds, valid)
        for one, other in zip(jax.tree.leaves(last), jax.tree.leaves(states)):
            np.testing.assert_allclose(one, other[track], rtol=1e-4, atol=1e-5)
        for one, other in zip(jax.tree.leaves(consecutive), jax.tree.leaves(steps)):
            np.testing.assert_allclose(np.asarray(one)[: len(mine)], np.asarray(other)[mine], rtol=1e-4, atol=1e-5)
    assert not np.array_equal(states.poses.translation[0], states.poses.translation[1])
    assert (np.asarray(steps.points)[[2, 5]] == 0).all()
