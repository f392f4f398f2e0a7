"""Elastic bands as explicit point pairs: how many, where, what they cost and what they allow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.helpers import cast, random_like, random_rotations, scipy_rotation, turned, two_limbs
from voodoo_jax.geometry.rigid import Poses, apply, compose, inverse, quat_exp
from voodoo_jax.kernels.bands import link_moments, prior_moments
from voodoo_jax.kernels.eigen import align
from voodoo_jax.model.body import Body, bands
from voodoo_jax.model.body_file import load_body

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")


def moments_of_pairs(pairs):
    """Sum of w [1, c] [1, p]^T over a list of (weight, model point, data point)."""
    out = np.zeros((4, 4))
    for w, c, p in pairs:
        out += w * np.outer([1, *np.asarray(c)], [1, *np.asarray(p)])
    return out


@pytest.mark.parametrize(
    "axes,count,points",
    [
        ((0.0, 0.0), 1, [(0, 0, 0)]),
        ((0.03, 0.0), 2, [(0.03, 0, 0), (-0.03, 0, 0)]),
        ((0.0, 0.02), 2, [(0, 0.02, 0), (0, -0.02, 0)]),
        ((0.03, 0.02), 4, [(0.03, 0, 0), (-0.03, 0, 0), (0, 0.02, 0), (0, -0.02, 0)]),
    ],
    ids=["universal", "hinge x", "hinge y", "elliptic"],
)
def test_special_cases(axes, count, points):
    body = two_limbs(axes, weight=0.7)
    found = bands(body)
    used = np.asarray(found.weights[0]) > 0
    assert used.sum() == count
    np.testing.assert_allclose(found.weights[0][used], 0.7 / count, rtol=1e-6)
    np.testing.assert_allclose(found.first_points[0][used], np.array(points) + [0, 0, 0.4], atol=1e-6)
    np.testing.assert_allclose(found.second_points[0][used], points, atol=1e-6)


@pytest.mark.parametrize("name", ["human", "human10", "arm", "dog"])
def test_weights_and_rest_pose(name):
    body = load_body(name)
    found = bands(body)
    np.testing.assert_allclose(found.weights.sum(-1), body.weights, rtol=1e-6)
    # in the rest pose every band has length zero
    ends = [
        apply(body.rest[jnp.array(limbs)][:, None], points)
        for limbs, points in (
            (body.topology.parents, found.first_points),
            (body.topology.children, found.second_points),
        )
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-5)


def test_moments_are_explicit_pairs_on_both_limbs(x64, rng):
    body = cast(load_body("arm"), jnp.float64)  # has universal, hinge and elliptic joints
    poses = turned(rng, body.rest, 0.05, 20)
    strength = jnp.asarray(rng.uniform(0.5, 2, body.limb_count))
    held = bands(body)
    found = link_moments(held, poses, strength)
    lists = [[] for _ in range(body.limb_count)]
    for j, (parent, child) in enumerate(zip(body.topology.parents, body.topology.children)):
        for w, on_parent, on_child in zip(held.weights[j], held.first_points[j], held.second_points[j]):
            seen = lambda own, point, other: apply(inverse(poses[own]), apply(poses[other], point))  # noqa: E731
            lists[parent].append((w * strength[parent], on_parent, seen(parent, on_child, child)))
            lists[child].append((w * strength[child], on_child, seen(child, on_parent, parent)))
    np.testing.assert_allclose(found, [moments_of_pairs(pairs) for pairs in lists], atol=1e-12)


def relax(body: Body, poses: Poses, steps: int) -> Poses:
    """Repeats the solve with bands, and per limb as much weight again that holds it where it is (no preference).

    Without any other weight both sides of a joint would move the whole way and swap places for ever.
    """
    held = bands(body)
    offsets = np.concatenate([np.eye(3), -np.eye(3)]) * 0.2
    middles = np.asarray(body.sizes)[:, 4] / 2
    inertia = [moments_of_pairs([(0.5, o + [0, 0, m], o + [0, 0, m]) for o in offsets]) for m in middles]

    def step(_, poses):
        total = link_moments(held, poses, jnp.ones_like(body.sizes[:, 0]))
        motion = jax.vmap(align)(total + jnp.array(inertia))
        return compose(poses, Poses(motion.rotation, motion.translation))

    return jax.jit(lambda p: jax.lax.fori_loop(0, steps, step, p))(poses)


def gaps(body: Body, poses: Poses) -> np.ndarray:
    """Lengths of the bands in use, metres."""
    held = bands(body)
    ends = [
        apply(poses[jnp.array(limbs)][:, None], points)
        for limbs, points in (
            (body.topology.parents, held.first_points),
            (body.topology.children, held.second_points),
        )
    ]
    return np.linalg.norm(np.asarray(ends[0] - ends[1]), axis=-1)[np.asarray(held.weights) > 0]


def test_bands_alone_close_gaps(x64, rng):
    body = cast(load_body("human"), jnp.float64)
    start = turned(rng, body.rest, 0.05, 10)
    assert gaps(body, start).max() > 0.04
    assert gaps(body, relax(body, start, 500)).max() < 2e-3


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_hinge_turns_about_its_own_axis_only(x64, axis):
    """Bands along x: turning the child about x costs nothing, about y and z it is turned back."""
    body = cast(two_limbs((0.05, 0.0)), jnp.float64)
    turn = quat_exp(jnp.zeros((2, 3)).at[1, axis].set(0.3))
    start = compose(body.rest, Poses(turn, jnp.zeros((2, 3))))  # about the joint, which is the limb's origin
    end = relax(body, start, 600)
    between = [scipy_rotation(p.rotation[0]).inv() * scipy_rotation(p.rotation[1]) for p in (start, end)]
    angles = [r.magnitude() for r in between]
    np.testing.assert_allclose(angles[0], 0.3, atol=1e-9)
    np.testing.assert_allclose(angles[1], 0.3 if axis == 0 else 0.0, atol=1e-3)


def random_prior(rng):
    """Middle, pose, prediction, weight, and weight times radius squared."""
    pose, predicted = (
        Poses(jnp.asarray(random_rotations(rng, 1)[0]), jnp.asarray(rng.normal(size=3))) for _ in range(2)
    )
    return jnp.array([0.0, 0.0, 0.2]), pose, predicted, jnp.asarray(3.0), jnp.asarray(3.0 * 0.4**2)


def test_prior_is_six_explicit_pairs(x64, rng):
    middle, pose, predicted, weight, square = random_prior(rng)
    pairs = []
    for offset in np.concatenate([np.eye(3), -np.eye(3)]) * 0.4:
        model = middle + offset
        pairs.append((3.0 / 6, model, apply(inverse(pose), apply(predicted, model))))
    found, second = prior_moments(middle, pose, predicted, weight, square)
    np.testing.assert_allclose(second, moments_of_pairs([(w, c, c) for w, c, _ in pairs])[1:, 1:], atol=1e-12)
    np.testing.assert_allclose(found, moments_of_pairs(pairs), atol=1e-12)


def test_prior_alone_leads_to_the_prediction(x64, rng):
    middle, pose, predicted, weight, square = random_prior(rng)
    motion = align(prior_moments(middle, pose, predicted, weight, square)[0])
    moved = compose(pose, Poses(motion.rotation, motion.translation))
    assert (scipy_rotation(moved.rotation).inv() * scipy_rotation(predicted.rotation)).magnitude() < 1e-7
    np.testing.assert_allclose(moved.translation, predicted.translation, atol=1e-12)
    assert motion.gap > 0.5


@pytest.mark.parametrize("angle", [1e-3, 1e-2])
def test_cost_of_turning_against_the_prior(x64, rng, angle):
    """2/3 weight radius^2 angle^2, about any axis through the middle."""
    middle, pose, _, weight, square = random_prior(rng)
    axis = random_like(rng, middle)
    q = quat_exp(axis / jnp.linalg.norm(axis) * angle)
    about_middle = Poses(q, middle - apply(Poses(q, jnp.zeros(3)), middle))
    m, _ = prior_moments(middle, pose, compose(pose, about_middle), weight, square)
    # the sum of squares from moments of offsets from the middle; both squared lengths are weight radius^2
    shift = np.eye(4)
    shift[1:, 0] = -middle
    centred = shift @ np.asarray(m) @ shift.T
    cost = 2 * 3.0 * 0.4**2 - 2 * np.trace(centred[1:, 1:])
    np.testing.assert_allclose(cost, 2 / 3 * 3.0 * 0.4**2 * angle**2, rtol=1e-4)
