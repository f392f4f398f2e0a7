"""Two passes, there and back in time, become one: their mean where they agree, one of them where they do not."""

import jax
import jax.numpy as jnp
import numpy as np

import voodoo_jax as vj
from voodoo_jax.config.options import FlexibleSettings
from voodoo_jax.trackers.flexible.filters import Seen, heading, start, turned_body
from voodoo_jax.trackers.flexible.flexible_body import LIMBS, flexible_body
from voodoo_jax.trackers.flexible.scores import Score
from voodoo_jax.trackers.flexible.tracker import better, descent, numbers, shape_of, smoothed

FRAMES = 12
WEIGHING = numbers(FlexibleSettings()).weighing


def seen(x: np.ndarray, surface: float = 0.5, explained: float = 0.9) -> Seen:
    part, limb = np.zeros((FRAMES, 15)), np.full((FRAMES, 4), 0.5)
    of = lambda a: jnp.asarray(a, jnp.float32)  # noqa: E731
    score = Score(of(limb), of(np.full((FRAMES, 4), surface)), of(limb), of(0.1 * limb), of(limb), of(0 * limb))
    return Seen(
        of(x), of(np.full((FRAMES, 4, 3), 0.02)), of(np.ones((FRAMES, 16))), score, of(np.full(FRAMES, explained)),
        of(np.full(FRAMES, 0.02)), of(part), of(part), of(np.zeros(FRAMES)), of(np.zeros((FRAMES, 16))),
        jnp.zeros(FRAMES, jnp.int32), of(np.zeros(FRAMES)),
    )  # fmt: skip


def test_where_passes_agree_it_is_their_mean_and_where_not_the_better_ones():
    x = np.random.default_rng(0).normal(0, 0.5, (16, 3))[None].repeat(FRAMES, 0)
    back = x.copy()
    back[..., 0] += 0.04
    back[:, 4] += 0.6  # a wrist elsewhere
    np.testing.assert_allclose(better(seen(x), seen(back), WEIGHING).x[:, 5], x[:, 5] + [0.02, 0, 0], atol=1e-5)
    np.testing.assert_allclose(better(seen(x), seen(back), WEIGHING).x[:, 4], x[:, 4], atol=1e-5)
    chosen = better(seen(x, surface=0.0), seen(back, surface=1.0), WEIGHING).x[:, 4]
    np.testing.assert_allclose(chosen - x[:, 4], back[:, 4] - back[:, 2] - x[:, 4] + x[:, 2], atol=0.03)
    whole = better(seen(x, explained=0.5), seen(back), WEIGHING).x[:, 4]
    np.testing.assert_allclose(whole, back[:, 4], atol=1e-5)


def test_passes_whose_trunks_are_elsewhere_are_not_mixed():
    x = np.random.default_rng(0).normal(0, 0.5, (16, 3))[None].repeat(FRAMES, 0)
    back = x.copy()
    back[:, [2, 5]] += 0.4  # shoulders
    np.testing.assert_allclose(better(seen(x), seen(back), WEIGHING).x[:, 10:], x[:, 10:], atol=1e-5)


def test_a_body_turns_about_the_middle_of_its_trunk():
    body, up = flexible_body(vj.human(), 1.75), jnp.array([0.0, 0.0, 1.0])
    state = start(jax.random.PRNGKey(0), body, body.rest, shape_of(FlexibleSettings()))
    moved = turned_body(state, 0.5 * up)
    np.testing.assert_allclose(heading(moved.x, up) - heading(state.x, up), 0.5, atol=1e-5)
    np.testing.assert_allclose(moved.x[LIMBS[:, 0]].mean(0), state.x[LIMBS[:, 0]].mean(0), atol=1e-5)
    apart = lambda s: jnp.linalg.norm(s.particles - s.x[0], axis=-1)  # noqa: E731
    np.testing.assert_allclose(apart(moved), apart(state), atol=1e-5)  # limbs go along


def test_hypotheses_are_followed_back_from_the_one_that_fits_last():
    fit = jnp.array([[9.0, 0.0], [5.0, 0.0], [0.0, 1.0]])
    follows = jnp.array([[1, 1], [0, 0], [0, 0]])
    every = seen(np.zeros((FRAMES, 16, 3)))._replace(fit=fit, follows=follows, anew=jnp.zeros((3, 2)))
    np.testing.assert_array_equal(descent(every), [1, 0, 1])
    np.testing.assert_array_equal(descent(every, online=True), [0, 0, 1])
    anew = every._replace(anew=jnp.array([[0, 0], [0, 0], [0, 1.0]]))  # the last one: before it, others fit best
    np.testing.assert_array_equal(descent(anew), [1, 0, 1])
    anew = every._replace(anew=jnp.array([[0, 0], [1.0, 0], [0, 0]]))
    np.testing.assert_array_equal(descent(anew), [0, 0, 1])


def test_smoothing_takes_noise_and_leaves_the_way():
    t = np.arange(60) / 15
    way = np.zeros((60, 16, 3), np.float32)
    way[..., 0] = 0.5 * np.sin(2 * np.pi * 0.5 * t)[:, None]
    noise = np.random.default_rng(0).normal(0, 0.02, way.shape).astype(np.float32)
    found = smoothed(way + noise, (t * 1e9).astype(np.int64))
    assert np.std(found - way) < 0.75 * 0.02
    assert np.abs(smoothed(way, (t * 1e9).astype(np.int64)) - way)[3:-3].max() < 0.01
    np.testing.assert_array_equal(smoothed(way[:1], np.zeros(1, np.int64)), way[:1])


def test_the_first_chunk_is_the_program_of_all_others():
    """A state that begins with other types than a frame leaves would be compiled for twice."""
    body = flexible_body(vj.human(), 1.75)
    state = start(jax.random.PRNGKey(0), body, body.rest, shape_of(FlexibleSettings()))
    assert {(a.dtype, a.weak_type) for a in jax.tree.leaves(state)} == {(jnp.dtype(jnp.float32), False)}
