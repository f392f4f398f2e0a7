"""Each ingredient of Knoop 2006 and 2007 by itself: experiments/papers takes each away, and its test fails."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import frame_points, icp_options, two_limbs
from voodoo_jax.config.options import FeatureSettings
from voodoo_jax.config.presets import preset
from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.kernels.assignment import sampled
from voodoo_jax.kernels.correspondences import FREE, ON_BODY, Points, Sampling, match, sums
from voodoo_jax.kernels.eigen import align
from voodoo_jax.kernels.frustum import closest_point
from voodoo_jax.kernels.landmarks import Features, feature_sums
from voodoo_jax.model.body import bands
from voodoo_jax.model.body_file import load_body
from voodoo_jax.solve.frame import Loop, icp_step, solve_frame
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.solve.pulls import Problem, adjacency, pulls_of, seen_at
from voodoo_jax.solve.scan import at_rest, options_from, predict

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

BODY = two_limbs()
SENSOR = (2.0, 0.4, 0.5)
ALL = dict(body_enlarge=10.0, limb_enlarge=10.0, max_distance=10.0, robust_scale=float("inf"), near_side=False)


def points(*xyz, kind=None) -> Points:
    found = frame_points(np.array(xyz, float), [SENSOR])
    return (
        found if kind is None else eqx.tree_at(lambda p: p.limb, found, jnp.asarray(kind), is_leaf=lambda x: x is None)
    )


def used(seen: Points, body=BODY, **options) -> np.ndarray:
    """[limb, point] which pairs there are."""
    some = icp_options(**(ALL | options)).match
    return np.asarray(match(body.sizes, body.rest, seen, adjacency(body.topology), some, body.present).weight) > 0


def test_a_limb_is_a_tapering_elliptic_cylinder_with_ends():
    size = jnp.array([0.10, 0.05, 0.06, 0.03, 0.4])
    of = lambda *p: closest_point(size, *(jnp.array([float(v)]) for v in p), refine=8)  # noqa: E731
    low, high = of(1.0, 0.0, 0.0), of(1.0, 0.0, 0.4)
    assert float(low.x[0]) == pytest.approx(0.10, abs=2e-3) and float(high.x[0]) < 0.09  # it tapers
    assert float(of(0.0, 1.0, 0.0).y[0]) == pytest.approx(0.05, abs=2e-3)  # an ellipse
    end = of(0.01, 0.005, 0.5)
    assert float(end.z[0]) == pytest.approx(0.4) and float(end.x[0]) == pytest.approx(0.01)  # on the end's plane


def test_a_point_is_a_measurement_of_the_closest_limb():
    z = np.array([0.05, 0.2, 0.35, 0.45, 0.6, 0.75])
    found = used(points(*((0.07, 0.0, v) for v in z)))
    assert (found.sum(0) == 1).all() and (found.argmax(0) == (z > 0.4)).all()


def test_points_far_from_the_body_from_limbs_or_from_their_pair_are_discarded():
    near, far = (0.06, 0.0, 0.2), (0.36, 0.0, 0.2)
    assert used(points(near, far)).any(0).all()
    for gate in (dict(body_enlarge=0.1), dict(limb_enlarge=0.1), dict(max_distance=0.1)):
        assert used(points(near, far), BODY, **gate).any(0).tolist() == [True, False], gate


def test_point_number_reduction_keeps_few_points_and_thins_many():
    chosen = jnp.arange(200)[None] < jnp.array([[200], [10]])
    kept = sampled(chosen, Sampling(jnp.asarray(0.5), jnp.asarray(20), jnp.asarray(60)))
    assert kept.sum(1).tolist() == [60, 10] and not bool(jnp.any(kept & ~chosen))
    assert int(sampled(chosen, Sampling(jnp.asarray(0.1), jnp.asarray(30), jnp.asarray(60))).sum(1)[0]) == 30
    assert int(sampled(chosen, Sampling(jnp.asarray(0.2), jnp.asarray(5), jnp.asarray(60))).sum(1)[0]) == 40


def test_points_known_to_be_on_the_body_and_on_a_limb():
    far = (0.36, 0.0, 0.2)
    assert not used(points(far), body_enlarge=0.1).any()
    assert used(points(far, kind=[ON_BODY]), body_enlarge=0.1).any()
    low = (0.06, 0.0, 0.2)
    assert used(points(low, low, kind=[FREE, 1]))[:, 1].tolist() == [False, True]
    assert used(points(low, low, kind=[FREE, 1]))[:, 0].tolist() == [True, False]


def features(row: int, origin, direction) -> Features:
    f = lambda v: jnp.asarray(v, jnp.float32)  # noqa: E731
    return Features(jnp.array([[row]]), f([origin]), f([direction]), f([1.0]))


def test_a_named_point_pulls_to_its_place_and_a_line_of_sight_to_its_closest_point():
    body = load_body("human10")
    row = body.topology.sites.index("sellion")
    limb = body.topology.site_limbs[row]
    there = np.asarray(apply(body.rest[limb], body.sites[row]))
    far = icp_options(**ALL).features
    far = eqx.tree_at(lambda o: (o.robust_scale, o.max_distance), far, (jnp.asarray(jnp.inf), jnp.asarray(10.0)))
    place = feature_sums(body, body.rest, features(row, there + [0.1, 0.2, 0.0], [0, 0, 0]), far)
    assert float(place.squares) == pytest.approx(0.05, rel=1e-3)
    line = feature_sums(body, body.rest, features(row, there + [0.0, 3.0, 0.1], [0, 1, 0]), far)
    assert float(line.squares) == pytest.approx(0.01, rel=1e-3)
    assert float(line.weight[limb]) == 1 and float(jnp.sum(line.weight)) == 1
    shift = np.asarray(line.moments[limb, 0, 1:] - line.moments[limb, 1:, 0])  # data less model, limb frame
    assert np.linalg.norm(shift) == pytest.approx(0.1, rel=1e-3)


def test_a_measurement_that_weighs_three_counts_as_three():
    """And costs no more: moments of one list, weighted."""
    seen, options = points((0.06, 0.0, 0.2), (0.0, 0.07, 0.1)), icp_options(**ALL).match
    near = adjacency(BODY.topology)
    heavy = eqx.tree_at(lambda p: p.weight, seen, jnp.array([3.0, 1.0]))
    often = points((0.06, 0.0, 0.2), (0.06, 0.0, 0.2), (0.06, 0.0, 0.2), (0.0, 0.07, 0.1))
    once, thrice = (sums(match(BODY.sizes, BODY.rest, p, near, options)).moments for p in (heavy, often))
    np.testing.assert_allclose(once, thrice, rtol=1e-5)
    assert float(once[0, 0, 0]) == 4


def test_bands_weigh_as_a_limbs_own_measurements_do():
    """The ratio of artificial to measured pairs is constant, so that stiffness is (2007, sec. 4.3)."""
    few = [(0.06, 0.0, 0.1), (0.0, 0.06, 0.2)]
    options = icp_options(ratio=0.55, floor=0.0, **ALL)

    def strength(*xyz) -> np.ndarray:
        problem = Problem.build(BODY, points(*xyz), BODY.rest, options)
        return np.asarray(pulls_of(seen_at(BODY.rest, problem), BODY.rest, problem).strength)

    np.testing.assert_allclose(strength(*few, (0.06, 0.0, 0.6)), [1.1, 0.55], rtol=1e-5)
    np.testing.assert_allclose(strength(*few * 2, (0.06, 0.0, 0.6)), [2.2, 0.55], rtol=1e-5)


def test_the_best_rotation_and_translation():
    rng = np.random.default_rng(0)
    model, (s, c) = rng.normal(size=(20, 3)), (np.sin(0.7), np.cos(0.7))
    data = model @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [0.3, -0.2, 0.1]
    one = np.ones((20, 1))
    moments = np.concatenate([one, model], 1).T @ np.concatenate([one, data], 1)
    found = align(jnp.asarray(moments, jnp.float32))
    np.testing.assert_allclose(found.rotation, [np.cos(0.35), 0, 0, np.sin(0.35)], atol=1e-4)
    np.testing.assert_allclose(found.translation, [0.3, -0.2, 0.1], atol=1e-4)


def test_limbs_are_solved_each_by_itself_and_bands_pass_the_motion_on():
    """With the papers' solver a step moves the limb that was measured; the other one follows by its band."""
    ring = [(0.05 * np.cos(t) + 0.02, 0.05 * np.sin(t), z) for t in np.arange(0, 6.2, 0.5) for z in (0.1, 0.2, 0.3)]

    def problem(ratio: float) -> Problem:
        options = icp_options(solver="per_limb", ratio=ratio, floor=0.5, prior=1e-6, **ALL)
        return Problem.build(BODY, points(*ring), BODY.rest, options)

    once, _ = icp_step(BODY.rest, problem(0.0))
    twice, _ = icp_step(icp_step(BODY.rest, problem(0.55))[0], problem(0.55))
    assert float(once.translation[0, 0]) > 0.01 and abs(float(once.translation[1, 0])) < 1e-4
    assert float(twice.translation[1, 0]) > 0.001


def test_it_repeats_until_the_measure_rests_or_so_many_steps_are_done():
    ring = [
        (0.05 * np.cos(t) + 0.02, 0.05 * np.sin(t), z) for t in np.arange(0, 6.2, 0.5) for z in (0.1, 0.3, 0.5, 0.7)
    ]
    steps = {}
    for epsilon, most in ((0.0, 4), (1e-6, 30), (1.0, 30)):
        options = icp_options(solver="per_limb", prior=1e-6, epsilon=epsilon, max_steps=most, **ALL)
        steps[epsilon] = int(solve_frame(BODY.rest, Problem.build(BODY, points(*ring), BODY.rest, options)).steps)
    assert steps[0.0] == 4 and 2 < steps[1e-6] < 30 and steps[1.0] <= 2
    still = Loop.begun(BODY.rest)._replace(quality=jnp.asarray(0.5))
    options = icp_options(solver="per_limb", epsilon=1e-3)
    assert bool(still.at_rest(jnp.asarray(0.4999), options, True)) and not bool(
        still.at_rest(jnp.asarray(0.4), options, True)
    )


def test_a_limb_that_is_taken_away_has_no_points():
    seen = points((0.06, 0.0, 0.2), (0.06, 0.0, 0.6))
    less = eqx.tree_at(lambda b: b.presence, BODY, jnp.array([1.0, 0.0]))
    assert used(seen)[1].any() and not used(seen, less)[1].any()


def test_a_frame_begins_where_the_last_one_ended():
    settings = preset("knoop2007")
    options = options_from(settings.solve, settings.track, settings.features)
    state = at_rest(Poses(BODY.rest.rotation, BODY.rest.translation + 0.3))
    moving = state._replace(velocity=jnp.ones_like(state.velocity))
    after = predict(BODY, options, moving, jnp.asarray(0.03), jnp.zeros(4))
    np.testing.assert_allclose(after.translation, BODY.rest.translation + 0.3, atol=1e-6)


def test_the_papers_body_is_a_tree_of_ten_limbs_with_three_kinds_of_joints():
    body = load_body("human10")
    t = body.topology
    assert len(t.limbs) == 10 and len(t.joints) == 9 and t.limbs[0] == "torso"
    parent = {t.limbs[c]: t.limbs[p] for p, c in zip(t.parents, t.children)}
    assert parent["l_forearm"] == "l_upper_arm" and parent["r_shank"] == "r_thigh" and parent["head"] == "torso"
    count = dict(zip(t.joints, (np.asarray(bands(body).weights) > 0).sum(1).tolist()))
    assert (count["neck"], count["l_shoulder"], count["l_elbow"], count["r_knee"]) == (4, 1, 2, 2)


def test_the_papers_numbers():
    settings = preset("knoop2007")
    names = FeatureNames(load_body("human10").topology, settings.features)
    weights = {name: names.find(name) for name in ("face", "left_hand", "right_hand")}
    assert [found[1] for found in weights.values() if found] == [30, 20, 20]  # and 1 of a point of depth
    assert 0.4 < settings.solve.ratio < 0.7 and settings.solve.max_steps == 6 and settings.solve.solver == "per_limb"
    assert settings.solve.overlap == "exclusive" and settings.track.damping == 0


def test_features_are_named_points_of_the_body():
    body = load_body("human10")
    names = FeatureNames(body.topology, FeatureSettings())
    rows = [names.look_up(name) for name in ("face", "left_hand", "skin")]
    site = body.topology.sites.index
    hands = site("l_metacarpal_phalanx_3"), site("r_metacarpal_phalanx_3")
    assert rows == [(site("sellion"),), hands[:1], (site("sellion"), *hands)]
