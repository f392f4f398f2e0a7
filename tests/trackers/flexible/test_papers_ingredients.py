"""Each ingredient of Hecht et al. 2009 by itself: experiments/papers takes each away, and its test fails."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import voodoo_jax as vj
from tests.trackers.flexible.test_scores import SIZE, context, view
from voodoo_jax.config.presets import preset
from voodoo_jax.trackers.flexible.filters import Inputs, State, carried_on, frame, head_moved, spread_and_drawn, start
from voodoo_jax.trackers.flexible.flexible_body import HEAD, LIMBS, flexible_body
from voodoo_jax.trackers.flexible.image_features import Extractor
from voodoo_jax.trackers.flexible.physics import frames, limb_spaces, relax, verlet
from voodoo_jax.trackers.flexible.scores import (
    NO_GUESS,
    LimbContext,
    View,
    expected,
    learn,
    limb_score,
    occlusion,
    systematic,
)
from voodoo_jax.trackers.flexible.tracker import numbers, shape_of
from voodoo_jax.trackers.flexible.vectors import vectors

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

PAPER = preset("hecht2009").flexible
SETTINGS = replace(PAPER, particles=64)
BODY, N, SHAPE = flexible_body(vj.human(), 1.75), numbers(SETTINGS), shape_of(SETTINGS)
UP = np.array([0, 0, 1], np.float32)
# a camera 3 m before the body that looks at it: x of the image to the body's right, y down, z away
TURN = np.array([[0, 1, 0], [0, 0, -1], [-1, 0, 0]], np.float32)
SHIFT = np.array([0, 1.0, 3.0], np.float32)
ARM, ALL = LIMBS[0], slice(None)


def seen_by_camera(**more) -> View:
    """What it sees: nothing, unless said."""
    return view(0.0)._replace(turn=TURN, shift=SHIFT, **more)


def given(head=BODY.rest[HEAD], head_seen: float = 1.0, learning: float = 0.0, **more) -> Inputs:
    no, none = np.float32(0), np.zeros(4, np.float32)
    what = Inputs(
        seen_by_camera(**more), np.zeros((4, 3), np.float32), none, none, np.asarray(head, np.float32),
        np.float32(head_seen), UP, np.float32(0.1), np.int32(0), np.float32(learning) + no, np.bool_(True),
        NO_GUESS,
    )  # fmt: skip
    return jax.tree.map(jnp.asarray, what)


def state(spread: float = 0.0) -> State:
    first = start(jax.random.key(0), BODY, BODY.rest, SHAPE)
    still = jnp.broadcast_to(BODY.rest[LIMBS][:, None], first.particles.shape)
    return first._replace(particles=still, previous=still, spread=jnp.full((4, 3), spread))


def test_the_papers_numbers():
    assert (PAPER.particles, PAPER.head_particles, PAPER.layers) == (200, 100, 1)
    assert 0.5 <= PAPER.velocity <= 0.8 and PAPER.depth_share == 0.25 and PAPER.depth_noise == (0.15, 0.5, 1.0)
    assert PAPER.follow_level == PAPER.follow_up == 0.8 and PAPER.refine == 0 and PAPER.points_weight == 0


def test_a_verlet_step_goes_on_as_before_and_falls():
    one = jnp.ones((16, 3))
    after = verlet(2 * one, one, -9.81 * one, jnp.asarray(0.1))
    np.testing.assert_allclose(after, 3 * one - 0.0981 * one, rtol=1e-5)


def test_springs_limits_and_collisions_each_hold():
    """Each with all that it does not need left out of the start."""
    settle = jax.jit(lambda x: relax(BODY, x, BODY.masses, 40, 0.02))
    size = lambda x, i, j: float(jnp.linalg.norm(x[i] - x[j]))  # noqa: E731
    x = BODY.rest
    longer = settle(x.at[4].add(jnp.array([0.0, 0.1, -0.2])))
    assert size(longer, 3, 4) == pytest.approx(size(x, 3, 4), rel=0.03)
    np.testing.assert_array_equal(longer[HEAD], x[HEAD])  # its mass is infinite
    thigh = settle(x.at[11].set(x[10] + jnp.array([-0.4, 0, 0.0])).at[12].set(x[10] + jnp.array([-0.6, 0, -0.3])))
    d = thigh[11] - thigh[10]
    assert float(d @ frames(thigh).lower[0]) / float(jnp.linalg.norm(d)) > -0.65  # no thigh goes straight back
    wrist = settle(x.at[4].set((x[8] + x[9]) / 2 + jnp.array([0.01, 0.02, 0.05])))
    deep, wide, _ = (wrist[4] - frames(wrist).middle) @ frames(wrist).upper.T
    assert float((deep / (0.9 * BODY.torso[0])) ** 2 + (wide / 0.149) ** 2) > 0.9  # no wrist stays in the torso
    crossed = settle(x.at[jnp.array([11, 12])].add(jnp.array([0.2, -0.3, 0.0])))
    assert float((crossed[12] - frames(crossed).middle) @ frames(crossed).lower[1]) > 0.01


def test_the_head_is_put_where_it_was_measured_and_the_body_follows_most_of_its_way_and_dangles():
    there = BODY.rest[HEAD] + jnp.array([0.1, 0.0, 0.0])
    x = head_moved(BODY, state(), given(there), N)
    np.testing.assert_allclose(x[HEAD], there, atol=1e-6)
    np.testing.assert_allclose((x - BODY.rest)[1:, 0], 0.08, atol=1e-4)
    np.testing.assert_allclose((x - BODY.rest)[1:, 2], -9.81 * 0.1**2, rtol=0.02)


def test_particles_go_on_with_a_share_of_their_velocity():
    s = state()
    moving = s._replace(previous=s.particles - 0.1)
    np.testing.assert_allclose(carried_on(moving, N) - s.particles, 0.065, atol=1e-5)


def layer(spread: float = 0.0, n=N, at=None, **more):
    """Particles after one layer of an arm held out to the left, where nothing is seen."""
    x = (
        BODY.rest.at[3]
        .set(BODY.rest[2] + jnp.array([0.0, 0.27, 0.0]))
        .at[4]
        .set(BODY.rest[2] + jnp.array([0, 0.5, 0.0]))
    )
    p = jnp.broadcast_to(x[LIMBS][:, None], (4, 64, 3, 3))
    v = seen_by_camera(**more)
    each = jax.tree.map(lambda a: jnp.broadcast_to(a, (4, *a.shape)), context((0, 0, 9.0), np.zeros((4, 3))))
    space = limb_spaces(BODY, vectors(x), 0.02, jnp.array([0.0, 0.0, 1.0, -1e3]))
    return run_layer(jax.random.key(1), p, jnp.full((4, 3), spread), space, each, v, n)


run_layer = jax.jit(
    lambda key, p, spread, space, each, v, n: spread_and_drawn(key, p, p, spread, space, each, v, n, SHAPE)
)
PLAIN = N._replace(depth_share=jnp.asarray(0.0))
DEVIATION = lambda found: float(found[3][0, 2])  # noqa: E731  (of the wrist)


def test_noise_has_a_base_and_more_where_particles_are_apart_and_where_the_image_moves():
    base = DEVIATION(layer(n=PLAIN))
    assert 0.01 < base < 0.06
    assert DEVIATION(layer(0.2, n=PLAIN)) > 1.3 * base
    moving = np.full((SIZE[0] // 4, SIZE[1] // 4), 255, np.uint8)
    assert DEVIATION(layer(n=PLAIN, motion=moving)) > 1.2 * base


def test_a_quarter_of_the_particles_is_spread_in_depth_most_at_the_end():
    found = np.asarray(layer()[0][0])  # [particle, point, axis]; the camera looks along -x
    plain = np.asarray(layer(n=PLAIN)[0][0])
    assert found[:, 2, 0].std() > 2.5 * plain[:, 2, 0].std()
    assert found[:, 2, 0].std() > 2 * found[:, 0, 0].std()
    far = np.abs(found[:, 2, 0] - np.median(found[:, 2, 0])) > 0.15
    assert 0.05 < far.mean() < 0.4


def test_particles_are_brought_back_to_what_a_limb_can_be():
    for found in (layer(), layer(0.2)):
        bones = np.linalg.norm(np.diff(np.asarray(found[0]), axis=2), axis=-1)[0]
        np.testing.assert_allclose(bones.mean(0), BODY.lengths[:2], rtol=0.03)
        assert bones.std(0).max() < 0.03


def score_of(v: View, c: LimbContext | None = None, n=N):
    """Of the resting left arm."""
    one = context((0, 0, 9.0), np.zeros((4, 3))) if c is None else c
    return _score(one, v, n)


SHOULDER, ELBOW, WRIST = (vectors(BODY.rest[row, None]) for row in ARM)
_score = jax.jit(lambda c, v, n: jax.tree.map(lambda a: a[0], limb_score((SHOULDER, ELBOW, WRIST), c, v, n.weighing)))


def painted(channel: int, value: int) -> np.ndarray:
    return np.full(SIZE, value << (8 * channel), np.uint32)


def test_borders_on_edges_and_surfaces_of_the_known_colour_score():
    assert (
        float(score_of(seen_by_camera(pixels=painted(3, 255))).edge)
        > 0.9
        > 0.1
        > float(score_of(seen_by_camera()).edge)
    )
    known = context((0, 0, 9.0), np.zeros((4, 3)))._replace(learnt=jnp.ones((2, 10)), colours=jnp.zeros((2, 10, 3)))
    alike, other = (float(score_of(seen_by_camera(pixels=p), known).surface) for p in (painted(0, 0), painted(1, 255)))
    assert alike > 0.9 and other < 0.3


def test_what_is_hidden_or_outside_of_the_image_scores_a_default():
    """Though it would score fully where it is seen."""
    known = context((0, 0, 9.0), np.zeros((4, 3)))._replace(learnt=jnp.ones((2, 10)), colours=jnp.zeros((2, 10, 3)))
    hidden = known._replace(hidden=jnp.zeros((SIZE[0] // 4, SIZE[1] // 4)))
    bright = seen_by_camera(pixels=painted(3, 255))
    away = bright._replace(shift=SHIFT + np.array([50, 0, 0], np.float32))
    assert float(score_of(bright, known).surface) > 0.9 and float(score_of(bright, known).edge) > 0.9
    for found in (score_of(bright, hidden), score_of(away, known)):
        assert float(found.edge) == pytest.approx(SETTINGS.hidden_edge, abs=1e-5)
        assert float(found.surface) == pytest.approx(SETTINGS.hidden_surface, abs=1e-5)


def test_an_arm_before_the_trunk_hides_it_from_the_other_limbs():
    ahead = jnp.array([0.25, 0.0, 0.0])
    x = BODY.rest.at[3].set(BODY.rest[2] + ahead).at[4].set(BODY.rest[5] + ahead)
    near = seen_by_camera()._replace(shift=np.array([0, 1.35, 1.5], np.float32))
    of = jax.jit(lambda x: occlusion(BODY, x, near))
    hidden, resting = np.asarray(of(x)), np.asarray(of(BODY.rest))
    across = (hidden[1] < 1.3) & (resting[1] > 1.3)  # nearer than the trunk, for the right arm
    assert across.sum() > 4
    assert (hidden[0][across] > 1.3).any()  # the arm does not hide itself


def test_ten_rings_of_colour_are_read_linearly_and_learnt_as_a_mean():
    ramp = jnp.broadcast_to(jnp.arange(10.0)[None, :, None], (2, 10, 3))
    np.testing.assert_allclose(expected(ramp)[0, :, 0], np.clip((np.arange(6) + 0.5) / 6 * 10 - 0.5, 0, 9), atol=1e-5)
    depth = np.full(SIZE, 3.0, np.float32)
    none = jnp.full((4, SIZE[0] // 4, SIZE[1] // 4), 1e6)
    rate = jnp.full((4, 2), 0.5)
    once = jax.jit(lambda v, c, known: learn(BODY, BODY.rest, frames(BODY.rest), v, none, c, known, rate))
    bright, dark = (seen_by_camera(depth=depth, pixels=painted(1, value)) for value in (255, 0))
    colours, learnt = once(bright, jnp.full((4, 2, 10, 3), 0.5), jnp.zeros((4, 2, 10)))
    seen = np.asarray(learnt[0]) > 0
    assert seen.mean() > 0.5
    np.testing.assert_allclose(np.asarray(colours[0])[seen][:, 1], 1.0, atol=1e-4)
    colours, learnt = once(dark, colours, learnt)
    np.testing.assert_allclose(np.asarray(colours[0])[seen][:, 1], 0.5, atol=1e-4)  # a running mean of both


def test_particles_are_drawn_by_their_weights():
    chosen = np.asarray(systematic(jnp.asarray(0.5), jnp.array([0.0, 0.75, 0.25, 0.0])))
    assert chosen.tolist() == [1, 1, 1, 2]


def square(at: int) -> np.ndarray:
    """A grey image with a bright square."""
    image = np.full((96, 128), 60, np.uint8)
    image[30:60, at : at + 30] = 160
    return image


def test_the_edge_image_has_gradients_and_twice_as_much_where_they_move():
    extract = Extractor()
    still = extract._detect_motion(square(40))[0].astype(float)
    again = extract._detect_motion(square(40))[0].astype(float)
    edge, motion = extract._detect_motion(square(46))
    assert still[45, 40] > 200 and again[45, 40] > 200 and still[45, 55] < 30  # of gradients, none inside
    lines = np.full((96, 128), 60, np.uint8)
    cv2.rectangle(lines, (100, 10), (120, 90), 160, -1)
    both = Extractor()
    both._detect_motion(np.maximum(lines, square(20)))
    found = both._detect_motion(np.maximum(lines, square(26)))[0].astype(float)
    assert 1.5 < found[45, 26] / found[45, 100] < 2.5
    assert 0 < edge[45, 43] < 255 and motion.max() > 0 and motion[20, 2] < motion.max() / 10


def test_a_frame_puts_the_filters_means_into_the_body_with_masses_by_how_sure_they_are():
    s = state(0.05)
    step = jax.jit(lambda s, g: frame(BODY, s, g, jax.random.key(3), N, SHAPE))
    after, seen = step(s, given())
    mass = SETTINGS.mass_base + SETTINGS.mass_variable * np.exp(-SETTINGS.mass_falloff * np.asarray(seen.spread))
    np.testing.assert_allclose(np.asarray(seen.masses)[LIMBS], mass, rtol=1e-4)
    middle = np.asarray(after.particles).mean(1)
    assert np.abs(middle - np.asarray(after.x)[LIMBS]).max() < 0.15
    np.testing.assert_array_equal(after.colours, s.colours)  # once learnt, colours are frozen
    depth = np.full(SIZE, 3.0, np.float32)
    learning, _ = step(s, given(learning=1.0, depth=depth, pixels=painted(1, 255)))
    assert float(jnp.abs(learning.colours - s.colours).max()) > 0.1
