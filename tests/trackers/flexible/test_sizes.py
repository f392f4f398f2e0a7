"""Sizes of the flexible body: what a body file's sizes make of it, and derivatives by them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import voodoo_jax as vj
from voodoo_jax.fitting.parameters import changed, parameters
from voodoo_jax.model.body import with_proportions
from voodoo_jax.trackers.flexible.cylinders import surface_distance
from voodoo_jax.trackers.flexible.filters import refined
from voodoo_jax.trackers.flexible.flexible_body import flexible_body
from voodoo_jax.trackers.flexible.vectors import vectors

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

BODY = flexible_body(vj.human(), 1.75)
BONES = ("l_upper_arm", "l_forearm", "r_upper_arm", "r_forearm", "l_thigh", "l_shank", "r_thigh", "r_shank")
SIZES = ("lengths", "radii", "tips", "stiffness", "torso")
ALL_LENGTHS = ("rest", "lengths", "radii", "tips", "torso", "skull", "stature")


def scattered(body, points: int, offset: float) -> tuple[jax.Array, jax.Array]:
    """Points near a body's surface, and its points moved away from where they are at rest."""
    rng = np.random.default_rng(4)
    cloud = np.asarray(body.rest)[rng.integers(0, 16, 4000)] + rng.normal(0, 0.12, (4000, 3))
    d = np.abs(np.asarray(surface_distance(body, body.rest, vectors(cloud)))).min(0)
    return jnp.asarray(cloud[d < 0.02][:points]), body.rest + jnp.asarray(rng.normal(0, offset, (16, 3)))


def test_gradients_by_sizes_agree_three_ways(x64):
    """Of what points lie off the surface after refinement: central differences, forward and reverse; all in float64.

    What changes is the stature with all lengths, and all sizes of one kind, each in a direction of its own.
    """
    human = flexible_body(vj.human(), 1.75)
    body = jax.tree.map(lambda a: jnp.asarray(np.asarray(a), jnp.float64), human)
    points, begin = scattered(body, 100, 0.01)
    share, rng = jnp.ones(len(points)), np.random.default_rng(5)
    directions = [jnp.asarray(rng.uniform(0.5, 1.0, np.shape(getattr(body, size)))) for size in SIZES]
    kept = np.asarray(jnp.argmin(jnp.abs(surface_distance(body, begin, vectors(points))), 0))
    of, all_lengths = (lambda b, names=names: [getattr(b, name) for name in names] for names in (SIZES, ALL_LENGTHS))

    def loss(by):
        grown = eqx.tree_at(all_lengths, body, [value * (1 + by[-1]) for value in all_lengths(body)])
        sizes = [value * (1 + by[k] * d) for k, (value, d) in enumerate(zip(of(grown), directions))]
        new = eqx.tree_at(of, grown, sizes)
        off = surface_distance(new, refined(new, begin, points, share, 2), vectors(points))
        return 1e2 * jnp.mean(jnp.take_along_axis(off, kept[None], 0) ** 2)

    count, step = len(SIZES) + 1, 1e-6
    both, zero = jax.jit(jax.value_and_grad(loss)), jnp.zeros(count)  # one program: it takes long to compile
    differences = [(float(both(d)[0]) - float(both(-d)[0])) / (2 * step) for d in step * jnp.eye(count)]
    forward, reverse = jax.jit(jax.jacfwd(loss))(zero), both(zero)[1]
    assert (np.abs(differences) > 1e-7).all()
    np.testing.assert_allclose(forward, differences, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(reverse, forward, rtol=1e-7, atol=1e-10)


def test_a_bodys_sizes_become_the_flexible_bodys():
    """Stature, lengths and girths; of the built-in human nothing changes, and derivatives go through."""
    human, big = vj.human(), with_proportions(vj.human(), {"l_thigh": 1.1, "r_thigh": 1.1}, 1.2)
    stout = flexible_body(big, 1.75)
    bones = np.asarray(stout.lengths / BODY.lengths)
    names = {name: k for k, name in enumerate(BONES)}
    assert bones[names["l_thigh"]] > 1.05 and abs(bones[names["l_upper_arm"]] - 1) < 0.01
    np.testing.assert_allclose(stout.radii, 1.2 * BODY.radii, rtol=1e-5)
    np.testing.assert_allclose(stout.torso, 1.2 * BODY.torso, rtol=1e-5)
    np.testing.assert_array_equal(flexible_body(human, 1.75).radii, BODY.radii)
    free = parameters(human, ("lengths.thigh", "radii.thigh.*"))

    def sizes(x):
        new = changed(human, free.changes(x))
        return jnp.concatenate([(b := flexible_body(new, new.scale)).lengths[4:5], b.radii[2, 0]])

    slope = jax.jit(jax.jacfwd(sizes))(jnp.zeros(3))
    step = 0.01 * jnp.eye(3)
    difference = jnp.stack([(sizes(d) - sizes(-d)) / 0.02 for d in step], 1)
    np.testing.assert_allclose(slope, difference, atol=2e-4)
    assert slope[0, 0] > 0.3 and slope[1, 1] > 0.05
