"""Limbs that no point tells of: where the next frame expects them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.rigid import Poses, apply, on_host
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.solve.scan import State, at_rest, options_from, predict
from voodoo_jax.trackers.icp.refine.restart_limbs import other_arms
from voodoo_jax.trackers.icp.trials import place

pytestmark = pytest.mark.usefixtures("compiled_in_a_hurry")

BODY = scaled(human(), 1.8)
LIMBS, JOINTS = BODY.topology.limbs, BODY.topology.joints
ARM = [LIMBS.index(name) for name in ("l_upper_arm", "l_forearm", "l_hand")]


def options(rest: float):
    settings = Settings()
    object.__setattr__(settings.track, "hidden_rest", rest)
    return options_from(settings.solve, settings.track)


@pytest.fixture
def walking() -> State:
    """Somebody whose left arm is out to the side and bent, moving and turning as one."""
    ahead, up = np.eye(3, dtype=np.float32)[::2]
    poses = other_arms(BODY, place(BODY, 2 * ahead, up, ahead))[6]
    spin = np.stack([Rotation.from_quat(q, scalar_first=True).inv().apply([0, 0, 1.5]) for q in poses.rotation])
    velocity = np.cross([0, 0, 1.5], poses.translation) + [1.0, 0.2, 0]
    state = jax.tree.map(jnp.asarray, at_rest(poses))
    return state._replace(spin=jnp.asarray(spin, jnp.float32), velocity=jnp.asarray(velocity, jnp.float32))


def hidden(state: State, limbs) -> State:
    return state._replace(seen=state.seen.at[np.array(limbs)].set(0.0))


def bend(poses: Poses, joint: str) -> float:
    """How far a joint is bent from the rest pose, radians."""
    j = JOINTS.index(joint)
    parent, child = BODY.topology.parents[j], BODY.topology.children[j]
    now, rest = (
        Rotation.from_quat(np.asarray(p.rotation)[parent], scalar_first=True).inv()
        * Rotation.from_quat(np.asarray(p.rotation)[child], scalar_first=True)
        for p in (poses, BODY.rest)
    )
    return float((now * rest.inv()).magnitude())


def test_who_is_seen_goes_on_as_before(walking):
    for cloud in (None, jnp.array([9.0, 9.0, 9.0, 500.0])):
        found = on_host(predict(BODY, options(0.3), walking, jnp.float32(0.03), cloud))
        moved = walking.poses.translation + 0.7 * 0.03 * walking.velocity
        np.testing.assert_allclose(found.translation, moved, atol=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_after_a_long_interval_limbs_have_not_swung_on(walking, sign):
    """The body as a whole goes on, or where its points went if enough are seen; it turns as in 85 ms."""
    was = walking._replace(cloud=jnp.array([2.0, 0.0, 1.0, 400.0]))
    root = lambda poses: np.asarray(poses.translation)[0]  # noqa: E731
    plain, few, many = (
        predict(BODY, options(0.3), was, jnp.float32(sign * 5.0), cloud)
        for cloud in (None, jnp.array([2.5, 0.4, 1.0, 30.0]), jnp.array([2.5, 0.4, 1.0, 400.0]))
    )
    gone = sign * 0.7 * 5.0 * np.asarray(was.velocity)[0]
    np.testing.assert_allclose(root(plain), root(was.poses) + gone, atol=1e-4)
    np.testing.assert_allclose(root(few), root(plain), atol=1e-6)
    np.testing.assert_allclose(root(many), root(was.poses) + [0.5, 0.4, 0.0], atol=1e-5)
    turn = [Rotation.from_quat(np.asarray(p.rotation), scalar_first=True) for p in (was.poses, plain)]
    np.testing.assert_allclose((turn[0].inv() * turn[1]).magnitude(), 0.7 * 1.5 * 0.085, atol=2e-3)
    apart = np.linalg.norm(np.diff(np.asarray(plain.translation), axis=0), axis=1)
    np.testing.assert_allclose(
        apart, np.linalg.norm(np.diff(np.asarray(was.poses.translation), axis=0), axis=1), atol=0.01
    )


@pytest.mark.parametrize(("rest", "seconds"), [(0.3, 0.1), (0.8, 0.033), (0.8, 2.0)])
def test_a_hidden_arm_hangs_on_and_comes_down(walking, rest, seconds):
    found = predict(BODY, options(rest), hidden(walking, ARM), jnp.float32(seconds))
    t = BODY.topology
    for joint in ("l_shoulder", "l_elbow"):
        j = JOINTS.index(joint)
        ends = (apply(found[t.parents[j]], BODY.parent_anchor.translation[j]),
                apply(found[t.children[j]], BODY.child_anchor.translation[j]))  # fmt: skip
        np.testing.assert_allclose(*ends, atol=1e-4)
        assert bend(walking.poses, joint) > 0.5
        assert bend(found, joint) == pytest.approx(bend(walking.poses, joint) * np.exp(-seconds / rest), abs=2e-3)
    others = np.setdiff1d(np.arange(len(LIMBS)), ARM)
    plain = predict(BODY, options(rest), walking, jnp.float32(seconds))
    np.testing.assert_allclose(found.translation[others], plain.translation[others], atol=1e-6)


def test_without_rest_it_keeps_its_bend(walking):
    found = predict(BODY, options(0.0), hidden(walking, ARM), jnp.float32(0.5))
    for joint in ("l_shoulder", "l_elbow"):
        assert bend(found, joint) == pytest.approx(bend(walking.poses, joint), abs=2e-3)


def test_half_hidden_is_half_way_and_has_a_derivative(walking):
    limb, seconds = ARM[1], jnp.float32(0.1)

    def place_of(seen):
        return predict(BODY, options(0.3), walking._replace(seen=walking.seen.at[limb].set(seen)), seconds).translation

    ends = place_of(1.0)[limb], place_of(0.0)[limb]
    np.testing.assert_allclose(place_of(0.5)[limb], (ends[0] + ends[1]) / 2, atol=1e-5)
    slope = jax.jacfwd(place_of)(0.5)
    assert bool(jnp.isfinite(slope).all())
    np.testing.assert_allclose(slope[limb], ends[0] - ends[1], atol=1e-4)
    at_home = at_rest(BODY.rest)
    back = jax.grad(
        lambda s: jnp.sum(predict(BODY, options(0.3), hidden(s, ARM), seconds).rotation ** 3), allow_int=True
    )
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(back(at_home)))
