"""The five kinds of measurement (Knoop 2007, sec. 5.1), each alone and all together, and their weights."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import all_finite, cast, frame_points, icp_options, seen_points, turned
from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.kernels.correspondences import FREE, ON_BODY, Points, match
from voodoo_jax.kernels.landmarks import Features, named_points
from voodoo_jax.model.body import joint_centres
from voodoo_jax.model.body_file import human
from voodoo_jax.solve.frame import icp_step, solve_frame
from voodoo_jax.solve.pulls import Problem, adjacency

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

SENSOR = (3.0, 0.3, 1.2)
LOOSE = dict(prior=1e-5, max_steps=60)
step = eqx.filter_jit(icp_step)  # as a whole: to compile each of its operations by itself takes longer


@cache
def scene():
    """The default body in its rest pose, points that a sensor sees of it and their limbs, a start 3 cm and 5 degrees
    off."""
    rng = np.random.default_rng(3)
    body = human()
    xyz = seen_points(rng, body, body.rest, SENSOR, 900)
    options = icp_options().match
    found = match(body.sizes, body.rest, frame_points(xyz, [SENSOR]), adjacency(body.topology), options)
    return body, xyz, np.asarray(jnp.argmax(found.weight, 0)), turned(rng, body.rest, 0.03, 5)


def points(xyz, kind=None, weight=None, dtype=jnp.float32) -> Points:
    base = frame_points(xyz, [SENSOR], dtype)
    limb = None if kind is None else jnp.broadcast_to(jnp.asarray(kind, jnp.int32), base.weight.shape)
    weight = base.weight if weight is None else base.weight * jnp.asarray(weight, dtype)
    return Points(base.xyz, weight, base.sensor, base.origins, limb)


def nothing(dtype=jnp.float32) -> Points:
    empty = points(np.zeros((4, 3)), dtype=dtype)
    return eqx.tree_at(lambda p: p.weight, empty, jnp.zeros_like(empty.weight))


def features(origins, directions, rows, weight=20.0, dtype=jnp.float32) -> Features:
    rows = np.asarray(rows, np.int32)
    rows = rows[:, None] if rows.ndim == 1 else rows
    f = lambda v: jnp.asarray(v, dtype)  # noqa: E731
    return Features(jnp.asarray(rows), f(origins), f(directions), f(np.broadcast_to(weight, len(rows))))


def places(body):
    limbs, c = named_points(body)
    return np.asarray(apply(body.rest[limbs], c))


def pairs(body, rows, **more) -> Features:
    at = places(body)[rows]
    return features(at, np.zeros_like(at), rows, **more)


def rays(body, rows, eye, **more) -> Features:
    d = places(body)[rows] - np.asarray(eye)
    return features(np.broadcast_to(eye, d.shape), d / np.linalg.norm(d, axis=1, keepdims=True), rows, **more)


def together(*some: Features) -> Features:
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *some)


@eqx.filter_jit
def solve(body, seen, start, options, named=None):
    return solve_frame(start, Problem.build(body, seen, start, options, named))


def error(body, poses: Poses) -> float:
    """Mean distance of the joint centres from where they are, metres."""
    off = np.asarray(joint_centres(body, poses)) - np.asarray(joint_centres(body, body.rest))
    return float(np.linalg.norm(off, axis=1).mean())


@pytest.mark.parametrize("solver", ["coupled", "per_limb"])
@pytest.mark.parametrize("kind", ["free", "body", "limb", "point", "ray", "all"])
def test_each_kind_alone_and_all_together(kind, solver):
    body, xyz, limb, start = scene()
    everything = np.arange(len(body.topology.sites) + len(body.topology.centres))
    two_eyes = together(rays(body, everything, SENSOR), rays(body, everything, (0.5, 3.0, 1.5)))
    some = [body.topology.sites.index(n) for n in ("sellion", "l_metacarpal_phalanx_3", "r_metacarpal_phalanx_3")]
    seen, named = {
        "free": (points(xyz), None),
        "body": (points(xyz, ON_BODY), None),
        "limb": (points(xyz, limb), None),
        "point": (nothing(), pairs(body, everything)),
        "ray": (nothing(), two_eyes),
        "all": (points(xyz, np.where(np.arange(900) % 3 == 0, limb, np.where(np.arange(900) % 3 == 1, ON_BODY, FREE))),
                together(pairs(body, everything[-3:]), rays(body, some, SENSOR))),
    }[kind]  # fmt: skip
    before = error(body, start)
    found = solve(body, seen, start, icp_options(solver=solver, **LOOSE), named)
    assert all_finite(found) and before > 0.025
    after = error(body, found.poses)
    assert after < (0.003 if kind in ("point", "ray") else 0.015), f"{100 * after:.2f} cm"


def test_points_known_to_be_on_the_body_pass_its_box():
    body, xyz, _, _ = scene()
    away = Poses(body.rest.rotation, body.rest.translation + jnp.array([0.0, 0.5, 0.0]))
    options = icp_options(body_enlarge=0.05, limb_enlarge=1.0, max_distance=1.0, robust_scale=float("inf")).match
    used = lambda seen: (match(body.sizes, away, seen, adjacency(body.topology), options).weight > 0).any(0)  # noqa: E731
    assert np.asarray(used(points(xyz))).mean() < 0.5
    assert np.asarray(used(points(xyz, ON_BODY))).all()


@pytest.mark.parametrize("overlap", ["exclusive", "shared", "adjacent"])
def test_points_of_a_limb_are_matched_to_it_alone(overlap):
    body, xyz, limb, _ = scene()
    wrong = (limb + 4) % body.limb_count  # a segmentation may say what it likes
    options = icp_options(overlap=overlap, limb_enlarge=0.01, max_distance=3.0, robust_scale=float("inf")).match
    found = match(body.sizes, body.rest, points(xyz, wrong), adjacency(body.topology), options)
    chosen = np.asarray(found.weight > 0)
    assert (chosen.sum(0) == 1).all() and (chosen.argmax(0) == wrong).all()


def test_a_feature_that_may_be_several_points_is_the_nearest_one():
    body, _, _, start = scene()
    names = ("sellion", "l_metacarpal_phalanx_3", "r_metacarpal_phalanx_3")
    rows = [body.topology.sites.index(n) for n in names]
    sure, maybe = rays(body, rows, SENSOR), rays(body, rows, SENSOR)
    choices = jnp.asarray([rows, rows[1:] + rows[:1], rows[2:] + rows[:2]], jnp.int32)
    maybe = eqx.tree_at(lambda f: f.point, maybe, choices)
    a = solve(body, nothing(), start, icp_options(), sure)
    b = solve(body, nothing(), start, icp_options(), maybe)
    np.testing.assert_allclose(a.poses.translation, b.poses.translation, atol=1e-5)


@pytest.mark.parametrize("solver", ["coupled", "per_limb"])
def test_a_weight_of_two_is_the_measurement_given_twice(x64, solver):
    body, xyz, limb, start = scene()
    body, start = cast((body, start), jnp.float64)
    options = icp_options(jnp.float64, solver=solver)
    kind, n = np.where(np.arange(900) % 2 == 0, limb, FREE), 300
    once = np.ones(900)
    heavy = once.copy()
    heavy[:n] = 2
    named = together(pairs(body, np.arange(3), dtype=jnp.float64), rays(body, np.arange(5), SENSOR, dtype=jnp.float64))
    double = eqx.tree_at(lambda f: f.weight, named, named.weight * 2)
    a = step(start, Problem.build(body, points(xyz, kind, heavy, jnp.float64), start, options, double))[0]
    again, kinds = np.concatenate([xyz, xyz[:n]]), np.concatenate([kind, kind[:n]])
    b = step(start, Problem.build(body, points(again, kinds, None, jnp.float64), start, options,
                                      together(named, named)))[0]  # fmt: skip
    np.testing.assert_allclose(a.translation, b.translation, atol=1e-10)
    np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-10)


@pytest.mark.parametrize("solver", ["coupled", "per_limb"])
def test_doubtful_measurements_leave_more_to_the_prediction(solver):
    """A quarter of the weight for four times the variance: as if the prediction weighed four times as much."""
    body, xyz, _, start = scene()
    options = icp_options(solver=solver, prior=0.003)
    firm = eqx.tree_at(lambda o: o.prior, options, options.prior * 4)
    doubtful = eqx.tree_at(lambda p: p.doubt, points(xyz, None, 0.25), jnp.asarray(4.0), is_leaf=lambda x: x is None)
    results = [
        step(start, Problem.build(body, seen, start, how))[0].translation
        for seen, how in ((doubtful, options), (points(xyz), firm), (points(xyz), options))
    ]
    np.testing.assert_allclose(results[0], results[1], atol=1e-5)
    assert np.abs(results[1] - results[2]).max() > 1e-3


def test_weights_change_numbers_and_no_program():
    """So they cost no time: the same program runs, whatever the weights (2007, sec. 6)."""
    body, xyz, _, start = scene()
    step = eqx.filter_jit(eqx.debug.assert_max_traces(icp_step, max_traces=1))
    named, options = rays(body, np.arange(5), SENSOR), icp_options()
    results = [
        step(start, Problem.build(body, points(xyz, None, w), start, options,
                                  eqx.tree_at(lambda f: f.weight, named, named.weight * w)))[0].translation
        for w in (1.0, 30.0)
    ]  # fmt: skip
    # all weights alike times thirty is the same problem
    np.testing.assert_allclose(*results, atol=1e-4)


@pytest.mark.parametrize("solver", ["coupled", "per_limb"])
def test_one_wrong_detection_does_not_throw_a_limb_off(solver):
    """4 % of the detections are wrong: in the data, not only in theory."""
    body, xyz, _, _ = scene()
    hand = body.topology.sites.index("l_metacarpal_phalanx_3")
    right = rays(body, [hand], SENSOR, weight=7.0)
    wrong = eqx.tree_at(lambda f: f.direction, right, jnp.asarray([[-0.95, 0.25, 0.187]]))
    options = icp_options(solver=solver)
    good = solve(body, points(xyz), body.rest, options, right)
    bad = solve(body, points(xyz), body.rest, options, wrong)
    limbs = jnp.asarray([body.topology.limbs.index(n) for n in ("l_forearm", "l_hand")])
    moved = np.linalg.norm(bad.poses.translation[limbs] - good.poses.translation[limbs], axis=1)
    assert moved.max() < 0.02, moved


@pytest.mark.parametrize(
    "factor,least,most,wanted", [(0.25, 0, 10**6, 0.25), (0.1, 20, 10**6, None), (1.0, 0, 15, None)]
)
def test_point_number_reduction_keeps_the_wanted_number_per_limb(factor, least, most, wanted):
    body, xyz, _, _ = scene()
    far = dict(max_distance=10.0, robust_scale=float("inf"))  # all that is chosen counts
    all_, some = (
        icp_options(**far, **o).match for o in ({}, dict(sampling=factor, sampling_min=least, sampling_max=most))
    )
    count = lambda o: np.asarray(  # noqa: E731
        (match(body.sizes, body.rest, points(xyz), adjacency(body.topology), o).weight > 0).sum(1)
    )
    full, reduced = count(all_), count(some)
    # rounding as the kernel rounds: half to even
    np.testing.assert_array_equal(reduced, np.minimum(np.clip(np.round(np.float32(factor) * full), least, most), full))
    if wanted:
        assert abs(reduced.sum() / full.sum() - wanted) < 0.02
