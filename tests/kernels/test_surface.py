"""Closest points on limbs against dense meshes, their errors in millimetres, and their gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from tests.support.helpers import central_difference, frustum_mesh, inside_limb
from voodoo_jax.kernels.frustum import SurfacePoint, closest_point, near_side
from voodoo_jax.model.body_file import load_body

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

# a0, b0, a1, b1, length; metres
REGULAR = {
    "round": (0.08, 0.08, 0.05, 0.05, 0.3),
    "equal ends": (0.08, 0.05, 0.08, 0.05, 0.25),
    "long thin": (0.012, 0.009, 0.008, 0.007, 0.8),
    "flat": (0.10, 0.02, 0.10, 0.02, 0.3),
    "twisted": (0.10, 0.02, 0.03, 0.09, 0.3),
    "human pelvis": (0.110, 0.168, 0.116, 0.136, 0.255),
    "dog leg": (0.072, 0.039, 0.036, 0.027, 0.216),
}
DEGENERATE = {
    "cone": (0.08, 0.06, 0.0, 0.0, 0.3),
    "disc": (0.08, 0.06, 0.07, 0.05, 0.0),
    "needle": (0.0, 0.0, 0.0, 0.0, 0.3),
    "point": (0.0, 0.0, 0.0, 0.0, 0.0),
    "short cone": (0.09, 0.09, 0.0, 0.0, 0.02),
}
ALL = REGULAR | DEGENERATE


def spread(rng, size, count, margin=0.15):
    """[count, 3] points evenly spread in the limb's box enlarged by a margin."""
    reach = np.array([max(size[0], size[2]), max(size[1], size[3]), size[4]]) + margin
    return rng.uniform([-reach[0], -reach[1], -margin], reach, (count, 3))


compiled = jax.jit(closest_point, static_argnames="refine")  # once for all sizes


def call(size, points, refine, dtype=jnp.float32):
    return compiled(jnp.asarray(size, dtype), *jnp.asarray(points, dtype).T, refine=refine)


def stacked(surface):
    return np.stack([np.asarray(v, np.float64) for v in surface[:3]], -1)


@pytest.mark.parametrize("refine,tolerance", [(4, 4e-4), (8, 2e-4)])
@pytest.mark.parametrize("name", ALL)
def test_refined_against_mesh(rng, name, refine, tolerance):
    size = np.maximum(ALL[name], 1e-6)
    points = spread(rng, size, 250)
    mesh = frustum_mesh(size)
    nearest, distance, _ = trimesh.proximity.closest_point(mesh, points)
    found = call(size, points, refine)
    assert np.abs(np.abs(found.distance) - distance).max() < tolerance
    # the reported point is on the surface, and as far away as reported
    on_mesh = trimesh.proximity.closest_point(mesh, stacked(found))[1]
    assert on_mesh.max() < 1e-4  # what the mesh itself is off by
    apart = np.linalg.norm(stacked(found) - points, axis=-1)
    np.testing.assert_allclose(np.abs(found.distance), apart, atol=2e-6)


@pytest.mark.parametrize("name", [n for n in ALL if min(ALL[n]) > 0])
def test_sign_against_mesh(rng, name):
    size = np.array(ALL[name])
    points = spread(rng, size, 400, margin=0.02)
    found = call(size, points, 4)
    clear = np.abs(found.distance) > 1e-4  # the mesh is not the surface
    inside = frustum_mesh(size, around=128, along=2).contains(points)
    assert inside.any() and not inside.all()
    np.testing.assert_array_equal((np.asarray(found.distance) < 0)[clear], inside[clear])


@pytest.mark.parametrize("seed", range(3))
def test_refined_on_random_limbs_against_mesh(rng, seed):
    # axis ratios up to 5 to 1, either way at either end
    ends = rng.uniform(0.03, 0.12, 2)
    a0, a1 = ends * rng.uniform(0.2, 1, 2)
    size = np.array([a0, ends[0], ends[1], a1, rng.uniform(0.03, 0.5)])
    points = spread(rng, size, 300)
    distance = trimesh.proximity.closest_point(frustum_mesh(size), points)[1]
    error = np.abs(np.abs(call(size, points, 8).distance) - distance)
    assert np.quantile(error, 0.99) < 2e-4
    assert error.max() < 2e-3


@pytest.mark.parametrize(
    "size", [(0.08, 0.08, 0.05, 0.05, 0.3), (0.05, 0.05, 0.05, 0.05, 0.1), (0.1, 0.1, 0.0, 0.0, 0.2)]
)
def test_unrefined_is_exact_for_round_limbs(x64, rng, size):
    points = spread(rng, size, 500)
    # the profile of a round limb is a trapezium: distance to its three edges in the half plane
    rho, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    corners = np.array([[0, 0], [size[0], 0], [size[2], size[4]], [0, size[4]]])
    best = np.full(len(points), np.inf)
    for start, end in zip(corners[:-1], corners[1:]):
        edge = end - start
        p = np.stack([rho, z], -1) - start
        s = np.clip(p @ edge / max(edge @ edge, 1e-30), 0, 1)
        best = np.minimum(best, np.linalg.norm(p - s[:, None] * edge, axis=-1))
    signed = np.where(inside_limb(np.maximum(size, 1e-6), points), -best, best)
    np.testing.assert_allclose(call(size, points, 0, jnp.float64).distance, signed, atol=3e-6)  # TINY


def test_error_of_the_unrefined_distance_on_people(rng):
    """The numbers in the docstring of closest_point, over points within 10 cm of a limb of the built-in human."""
    far, errors = [], []
    for size in np.asarray(load_body("human").sizes):
        points = spread(rng, size, 4000, margin=0.12)
        exact, rough = call(size, points, 12), call(size, points, 0)
        near = np.abs(exact.distance) < 0.1
        errors.append((np.abs(rough.distance) - np.abs(exact.distance))[near])
        outside = near & (np.asarray(exact.distance) > 0)
        far.append((np.asarray(rough.distance) - np.asarray(exact.distance))[outside])
    errors, far = np.concatenate(errors), np.concatenate(far)
    assert errors.min() > -1e-3  # the unrefined side lies a little inside
    assert 1e-4 < errors.mean() < 3.5e-4
    assert np.quantile(errors, 0.95) < 2e-3
    assert 5e-3 < errors.max() < 25e-3  # deep inside the pelvis
    assert far.max() < 7e-3


KINKS = [
    (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), (0.0, 0.0, 0.3), (0.0, 0.0, 0.5), (0.0, 0.0, -0.2), (0.08, 0.0, 0.0),
    (0.0, 0.06, 0.0), (0.05, 0.0, 0.3), (0.0, 0.05, 0.3), (0.2, 0.0, 0.1), (0.0, 0.2, 0.1), (1e-8, 0.0, 0.1),
    (0.01, 0.0, 0.1), (0.0, 0.01, 0.1), (-0.08, 0.0, 0.15), (0.3, 0.3, 3.0),
]  # fmt: skip


def total_and_gradients(size, points, refine):
    total = lambda size, points: sum(jnp.sum(jnp.sin(v)) for v in closest_point(size, *points.T, refine=refine)[:4])  # noqa: E731
    return jax.value_and_grad(total, (0, 1))(size, points)


@pytest.mark.parametrize("refine", [0, 4])
@pytest.mark.parametrize("name", ALL)
def test_gradients_are_finite_everywhere(name, refine):
    """On the axis, in the middle, on rims and surfaces: reverse mode, by the point and by the size."""
    size = jnp.asarray(ALL[name], jnp.float32)
    mesh_points = frustum_mesh(np.maximum(ALL[name], 1e-6), around=8, along=2).vertices
    points = jnp.asarray(np.concatenate([KINKS, mesh_points]), jnp.float32)

    value, gradients = total_and_gradients(size, points, refine)
    assert np.isfinite(value) and all(np.isfinite(g).all() for g in gradients)


@pytest.mark.parametrize("refine", [0, 4, 8])
def test_centre_of_a_round_limb(refine):
    found = call((0.08, 0.08, 0.08, 0.08, 0.4), [(0.0, 0.0, 0.2), (1e-9, 0.0, 0.2)], refine)
    np.testing.assert_allclose(found.distance, -0.08, atol=1e-6)


def derivative(size, points, by_size, by_points, refine):
    which = lambda size, points: closest_point(size, *points.T, refine=refine)[:4]  # noqa: E731
    return jax.jvp(which, (size, points), (by_size, by_points))[1]


@pytest.mark.parametrize("refine", [0, 8])
@pytest.mark.parametrize("name", REGULAR)
def test_gradient_against_central_difference(x64, rng, name, refine):
    size = jnp.asarray(REGULAR[name], jnp.float64)
    points = jnp.asarray(spread(rng, REGULAR[name], 300), jnp.float64)
    # not compiled: the compiler takes a minute over the derivative of eight iterations
    which = lambda size, points: closest_point(size, *points.T, refine=refine)[:4]  # noqa: E731
    directions = jnp.asarray(rng.normal(size=size.shape) * 0.1), jnp.asarray(rng.normal(size=points.shape))
    exact = derivative(size, points, *directions, refine)
    differences = [central_difference(lambda a: which(*a), (size, points), directions, h) for h in (1e-7, 4e-7)]
    # a kink between the two places shows as a disagreement of the differences themselves
    smooth = sum(np.abs(a - b) for a, b in zip(*differences)) < 1e-4
    assert smooth.mean() > 0.9
    for a, b in zip(exact, differences[0]):
        np.testing.assert_allclose(np.asarray(a)[smooth], np.asarray(b)[smooth], atol=2e-4)


@pytest.mark.parametrize("name", ["round", "equal ends", "twisted", "human pelvis", "cone"])
def test_near_side(rng, name):
    size = np.array(ALL[name])
    points = spread(rng, size, 400, margin=0.02)
    points[:, 2] = rng.uniform(0.05 * size[4], 0.9 * size[4], len(points))
    towards = rng.normal(size=(len(points), 2)) * 2
    before = call(size, points, 0)
    after = jax.jit(near_side)(jnp.asarray(size, jnp.float32), *jnp.asarray(points[:, :2].T, jnp.float32), before,
                      [*jnp.asarray(towards.T, jnp.float32), jnp.full(len(points), size[4] / 2)])  # fmt: skip
    s = np.asarray(before.z, np.float64) / size[4]
    axes = np.stack([size[0] + s * (size[2] - size[0]), size[1] + s * (size[3] - size[1])], -1)
    # where the ellipse is a unit circle, lines of sight stay lines
    u = towards / axes
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    flat, new = points[:, :2] / axes, stacked(after)[:, :2] / axes
    across = np.stack([-u[:, 1], u[:, 0]], -1)
    behind = np.sum(flat * u, -1) < 0
    assert 0.2 < behind.mean() < 0.8
    for a, b in zip(after[:4], before[:4]):
        np.testing.assert_array_equal(np.asarray(a)[~behind], np.asarray(b)[~behind])
    np.testing.assert_array_equal(after.z, before.z)
    moved = new[behind]
    np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), 1, atol=1e-3)  # on the ellipse at that height
    assert np.sum(moved * u[behind], -1).min() > -1e-3  # on the sensor's side
    lateral = np.clip(np.sum(flat * across, -1), -1, 1)[behind]
    np.testing.assert_allclose(np.sum(moved * across[behind], -1), lateral, atol=1e-3)  # same line of sight


def test_near_side_without_a_side():
    """A sensor that looks along the limb, and a point at the very edge: nothing moves, gradients stay finite."""
    size = jnp.array([0.08, 0.05, 0.08, 0.05, 0.3])

    def total(xy, towards):
        x, y = xy.T
        before = closest_point(size, x, y, jnp.full_like(x, 0.1))
        after = near_side(size, x, y, before, [*towards.T, jnp.zeros_like(x)])
        return jnp.sum(after.x + after.y), (before, after)

    xy = jnp.array([[-0.02, 0.01], [0.0, 0.0], [-0.01, 0.05], [-0.0, -0.2]])
    towards = jnp.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    gradients, (before, after) = jax.grad(total, (0, 1), has_aux=True)(xy, towards)
    assert all(np.isfinite(g).all() for g in gradients)
    assert isinstance(after, SurfacePoint)
    for a, b in zip(after[:4], before[:4]):
        np.testing.assert_array_equal(a[:2], b[:2])


@pytest.mark.parametrize(("above", "seen"), [(0.5, True), (0.02, False)])
def test_near_side_leaves_a_cap_that_is_seen(above: float, seen: bool):
    """Points of the end face behind the axis are where they seem to be, if the sensor looks onto that face."""
    size = jnp.array([0.1, 0.08, 0.06, 0.05, 0.3])
    x, y = jnp.array([-0.04, -0.02, 0.03, -0.09]), jnp.array([0.01, -0.03, 0.0, 0.0])
    z = jnp.array([0.301, 0.299, 0.301, 0.301])
    before = closest_point(size, x, y, z)
    ones = jnp.ones_like(x)
    after = near_side(size, x, y, before, [1.0 * ones, 0.0 * ones, (0.3 + above if seen else 0.3 - above) * ones])
    still = np.asarray(after.x == before.x)
    # the third is before the axis, the last one beside the rim
    np.testing.assert_array_equal(still, [seen, seen, True, False])
    upside_down = near_side(size, x, y, before, [1.0 * ones, 0.0 * ones, -1.0 * ones])
    np.testing.assert_array_equal(np.asarray(upside_down.x == before.x), [False, False, True, False])
