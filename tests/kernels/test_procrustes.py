"""Absolute orientation against an independent library, on degenerate clouds, and its derivative rule."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.support.helpers import all_finite, central_difference, random_rotations, scipy_rotation
from voodoo_jax.geometry.rigid import matrix
from voodoo_jax.kernels.eigen import align, horn_matrix, top_eigenpair

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

solve = jax.jit(align)


def moments_of(weight, model, data):
    """Sum of w [1, c] [1, p]^T, in whatever array library and precision comes in."""
    one = jnp.ones((len(model), 1), jnp.result_type(model))
    return jnp.einsum("n,ni,nj->ij", weight, jnp.concatenate([one, model], 1), jnp.concatenate([one, data], 1))


def pairs(rng, count=30, size=0.1):
    """Weights, model points, data points: a random motion and a little noise."""
    model = rng.normal(size=(count, 3)) * size
    rotation = scipy_rotation(random_rotations(rng, 1)[0])
    data = rotation.apply(model) + rng.normal(size=3) * size + rng.normal(size=(count, 3)) * 0.05 * size
    return rng.uniform(0, 2, count), model, data


def oracle(weight, model, data):
    """Rotation and translation by scipy."""
    c, p = (np.average(x, axis=0, weights=weight) for x in (model, data))
    rotation = Rotation.align_vectors(data - p, model - c, weights=weight)[0]
    return rotation, p - rotation.apply(c)


def assert_same(found, rotation, translation, degrees, metres):
    angle = (scipy_rotation(found.rotation).inv() * rotation).magnitude()
    assert np.degrees(angle) < degrees
    np.testing.assert_allclose(found.translation, translation, atol=metres)


# the nine clouds: model points, and the factor that mirrors the data; metres
TURN = np.linspace(0, 2 * np.pi, 16, endpoint=False)
RING = np.stack([np.cos(TURN) * 0.05, np.sin(TURN) * 0.05, 0 * TURN], -1)
OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
CLOUDS = {
    "one point": np.zeros((1, 3)),
    "two points": np.array([[0, 0, 0], [0, 0, 0.3]]),
    "collinear": np.array([[0, 0, z] for z in (0, 0.1, 0.3)]),
    "planar": np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0.2, 0.1, 0]]),
    "unit corners": np.eye(3) - 1 / 3,
    "octahedron": OCTAHEDRON,
    "circular cylinder": np.concatenate([RING + [0, 0, z] for z in np.linspace(-0.2, 0.2, 5)]),
    "mirrored": OCTAHEDRON,
    "generic": np.random.default_rng(0).normal(size=(8, 3)),
}
UNDETERMINED = ("one point", "two points", "collinear", "mirrored")


@pytest.mark.parametrize("seed", range(5))
def test_against_scipy(x64, rng, seed):
    weight, model, data = pairs(rng)
    assert_same(solve(moments_of(weight, model, data)), *oracle(weight, model, data), 1e-6, 1e-10)


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("turn", [0.0, 0.7, 3.1415])
def test_nine_clouds(name, turn):
    """Values and derivatives are finite on every cloud; the rotation is right wherever there is a right one."""
    rotation = Rotation.from_rotvec(np.array([0.6, 0.0, 0.8]) * turn)
    model = CLOUDS[name]
    data = rotation.apply(model * (1, 1, -1) if name == "mirrored" else model) + [0.1, -0.2, 0.05]
    moments = moments_of(jnp.ones(len(model)), jnp.asarray(model, jnp.float32), jnp.asarray(data, jnp.float32))
    found, forward, reverse, loss = derivatives(moments)
    assert all(all_finite(x) for x in (found, forward, reverse, loss))
    np.testing.assert_allclose(np.linalg.norm(found.rotation), 1, atol=1e-6)
    if name in UNDETERMINED:
        assert found.gap < 1e-4
    else:
        assert found.gap > 0.05
        assert_same(found, rotation, [0.1, -0.2, 0.05], 0.05, 1e-5)
    if name == "collinear":  # what can be said is said: the line comes to lie on the line
        moved = scipy_rotation(found.rotation).apply(model) + np.asarray(found.translation)
        np.testing.assert_allclose(moved, data, atol=1e-5)


@pytest.mark.parametrize("width", [0.3, 0.1, 0.03, 0.01, 0.003, 1e-3])
def test_nearly_on_a_line(rng, width):
    """Where a closed form of the eigenvector loses its digits, it is not used (docs/numerics.md#closed-forms): float32,
    any motion."""
    model = rng.normal(size=(200, 20, 3)) * [width, width / 2, 1]
    turns = random_rotations(rng, 200)
    data = np.stack([scipy_rotation(q).apply(m) for q, m in zip(turns, model)])
    moments = jax.vmap(lambda c, p: moments_of(jnp.ones(20), c, p))(
        *(jnp.asarray(x, jnp.float32) for x in (model, data))
    )
    found = jax.jit(jax.vmap(align))(moments)
    off = [np.degrees((scipy_rotation(q).inv() * scipy_rotation(a)).magnitude()) for q, a in zip(turns, found.rotation)]
    # the roll about the line is as uncertain as single precision makes it
    assert np.max(off) < 1e-4 / width**2 + 1e-3


def test_a_batch_is_its_parts(rng):
    """Bit for bit, also where some of a batch need the slower way, or are broken."""
    clouds = [CLOUDS[name] for name in ("generic", "collinear", "octahedron", "two points")]
    moments = np.stack([moments_of(np.ones(len(c)), c, c + [0.1, 0.0, 0.3]) for c in clouds]).astype(np.float32)
    together = jax.jit(jax.vmap(align))(moments).rotation
    for broken in (0.0, np.nan):
        pair = np.stack([moments[0], np.full((4, 4), broken, np.float32)])
        np.testing.assert_array_equal(jax.jit(jax.vmap(align))(pair).rotation[0], together[0])


@jax.jit
def derivatives(moments):
    loss = lambda m: jnp.sum(jnp.sin(align(m).rotation)) + jnp.sum(align(m).translation ** 2)  # noqa: E731
    return align(moments), jax.jacfwd(align)(moments), jax.jacrev(align)(moments), jax.grad(loss)(moments)


@pytest.mark.parametrize("angle", [179.0, 179.99, 180.0])
def test_half_a_turn(x64, rng, angle):
    _, model, _ = pairs(rng)
    axis = rng.normal(size=3)
    rotation = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(angle))
    found = solve(moments_of(np.ones(30), model, rotation.apply(model)))
    assert_same(found, rotation, np.zeros(3), 1e-6, 1e-10)


def test_translation_only(x64, rng):
    weight, model, _ = pairs(rng)
    found = solve(moments_of(weight, model, model + [0.3, -0.1, 0.2]))
    np.testing.assert_allclose(found.rotation, [1, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(found.translation, [0.3, -0.1, 0.2], atol=1e-12)


def test_no_weight_is_no_motion():
    found, *rest = derivatives(jnp.zeros((4, 4)))
    np.testing.assert_array_equal(found.rotation, [1, 0, 0, 0])
    np.testing.assert_array_equal(found.translation, [0, 0, 0])
    assert found.gap == 0 and found.weight == 0 and all_finite(rest)


def test_a_double_weight_is_a_double_pair(x64, rng):
    weight, model, data = pairs(rng)
    doubled = weight.copy()
    doubled[:10] *= 2
    twice = [np.concatenate([x, x[:10]]) for x in (weight, model, data)]
    a, b = solve(moments_of(doubled, model, data)), solve(moments_of(*twice))
    np.testing.assert_allclose(a.rotation, b.rotation, atol=1e-12)
    np.testing.assert_allclose(a.translation, b.translation, atol=1e-12)


@pytest.mark.parametrize("unit", [0.1, 1.0, 10.0, 1000.0])
@pytest.mark.parametrize("weight_scale", [1e-3, 1.0, 1e4])
def test_any_unit_and_weight_in_float32(unit, weight_scale):
    rng = np.random.default_rng(5)
    weight, model, data = pairs(rng, 256)
    rotation, translation = oracle(weight, model, data)
    args = (jnp.asarray(x, jnp.float32) for x in (weight * weight_scale, model * unit, data * unit))
    found, forward, reverse, loss = derivatives(moments_of(*args))
    assert all(all_finite(x) for x in (forward, reverse, loss))
    assert_same(found, rotation, translation * unit, 0.01, 1e-5 * unit)


@pytest.mark.parametrize("seed", range(3))
def test_rule_of_the_eigenvector(x64, rng, seed):
    """Against central differences, and against the library's own rule where that one is defined."""
    k, direction = (x + x.T for x in rng.normal(size=(2, 4, 4)))
    _, vectors = np.linalg.eigh(k)
    # the top one stands apart
    k, direction = jnp.asarray(k + 0.2 * np.outer(vectors[:, -1], vectors[:, -1])), jnp.asarray(direction)
    exact = jax.jvp(top_eigenpair, (k,), (direction,))[1]
    sign = lambda pair: (pair[0], pair[1] * np.sign(pair[1] @ vectors[:, -1]))  # noqa: E731
    numeric = central_difference(lambda m: sign(top_eigenpair(m)), jnp.asarray(k), jnp.asarray(direction), 1e-6)
    own = jax.jvp(lambda m: (lambda w, v: (w, v[:, -1]))(*jnp.linalg.eigh(m)), (k,), (direction,))[1]
    flip = np.sign(top_eigenpair(jnp.asarray(k))[1] @ vectors[:, -1])
    for i, factor in enumerate((1, flip)):
        np.testing.assert_allclose(exact[i] * factor, numeric[i], atol=1e-6)
        np.testing.assert_allclose(exact[i], own[i], atol=1e-8)


def test_rule_where_others_meet(x64):
    """Three equal eigenvalues below the top one: reverse mode of eigh is NaN there, the rule is exact."""
    k = jnp.diag(jnp.array([3.0, -1.0, -1.0, -1.0]))
    jacobian = jax.jacrev(lambda m: top_eigenpair(m)[1])(k)
    expected = np.zeros((4, 4, 4))
    for i in range(1, 4):
        expected[i, i, 0] = 0.25  # dv = (top - K)^-1 dK v
    top = np.sign(top_eigenpair(k)[1][0])
    np.testing.assert_allclose(jacobian * top, expected, atol=1e-9)
    assert not np.isfinite(jax.jacrev(lambda m: jnp.linalg.eigh(m)[1][:, -1])(k)).all()  # why the rule exists


@pytest.mark.parametrize("name", CLOUDS)
def test_second_derivatives(x64, name):
    model = jnp.asarray(CLOUDS[name])
    data = model @ matrix(jnp.array([0.8, 0.0, 0.6, 0.0])).T
    target = jnp.array([0.3, -0.5, 0.2, 0.7])
    loss = lambda d: jnp.sum(align(moments_of(jnp.ones(len(model)), model, d)).rotation * target)  # noqa: E731
    direction = jnp.asarray(np.random.default_rng(1).normal(size=data.shape)) * 0.1
    slope = jax.jit(lambda d: jnp.sum(jax.grad(loss)(d) * direction))
    second = jnp.sum(jax.jit(jax.grad(slope))(data) * direction)
    assert np.isfinite(second)
    if name not in UNDETERMINED:
        numeric = central_difference(lambda d: slope(d), data, direction, 1e-5)
        np.testing.assert_allclose(second, numeric, rtol=1e-4, atol=1e-5)


def test_horn_matrix_gives_the_cost(x64, rng):
    """q K q is the sum of p . R(q) c: the definition, without eigenvectors."""
    _, model, data = pairs(rng)
    for q in random_rotations(rng, 5):
        expected = np.sum(data * scipy_rotation(q).apply(model))
        np.testing.assert_allclose(q @ np.asarray(horn_matrix(jnp.asarray(model.T @ data))) @ q, expected, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 3.1), st.floats(-2, 2))
def test_turning_the_data_turns_the_result(seed, angle, shift):
    rng = np.random.default_rng(seed)
    weight, model, data = pairs(rng, 12, size=0.3)
    axis = rng.normal(size=3)
    extra = Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle)
    with jax.enable_x64(True):  # a fixture would last for all examples at once
        before = jax.tree.map(np.array, solve(moments_of(weight, model, data)))
        after = jax.tree.map(np.array, solve(moments_of(weight, model, extra.apply(data) + shift)))
    rotation = extra * scipy_rotation(before.rotation)
    if before.gap > 1e-3:
        assert_same(after, rotation, extra.apply(before.translation) + shift, 1e-5, 1e-8)
        np.testing.assert_allclose(after.gap, before.gap, atol=1e-9)
