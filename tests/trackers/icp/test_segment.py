"""What is not plausible about a pose makes it cost more."""

import numpy as np

from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.model.pose_library import Stance, in_stance
from voodoo_jax.trackers.icp.segment import FREE_DEPTH, IN_ANOTHER, implausible

BODY = scaled(human(), 1.75)
CHUNK = 4


def rated(poses: list[Poses]) -> np.ndarray:
    rotation = np.stack([np.asarray(each.rotation, np.float32) for each in poses])
    translation = np.stack([np.asarray(each.translation, np.float32) for each in poses])
    return implausible(BODY, rotation, translation, CHUNK)


def stance(*turns) -> Poses:
    body = in_stance(BODY, Stance(turns, (1.0,)))
    assert body is not None
    return on_host(body.rest)


def test_an_arm_in_the_trunk_costs_more_the_deeper_it_is():
    rest = on_host(BODY.rest)
    arm = BODY.topology.limbs.index("r_forearm")
    towards = rest.translation[BODY.topology.limbs.index("pelvis")] - rest.translation[arm]
    shares = np.linspace(0, 0.9, 7)

    def moved(share: float) -> Poses:
        place = np.array(rest.translation)
        place[arm] += np.float32(share) * towards * np.float32([1, 1, 0])
        return Poses(rest.rotation, place)

    found = rated([moved(share) for share in shares])
    assert found[0] == 1 and np.all(np.diff(found) >= -1e-6)
    # a forearm is in both the pelvis and the thigh: farther than what says nothing
    assert found[-1] > np.exp(0.5 * FREE_DEPTH / IN_ANOTHER)


def test_a_knee_bent_the_wrong_way_costs_more_and_one_bent_the_right_way_does_not():
    right, wrong = (stance(("l_knee", "y", turn)) for turn in (60.0, -60.0))
    found = rated([right, wrong, right, wrong, right])  # more than one chunk
    np.testing.assert_allclose(found[::2], 1.0)
    assert np.all(found[1::2] > 1.2)


def test_nothing_is_rated_where_there_is_nothing():
    limbs = BODY.limb_count
    none = np.zeros((0, limbs, 4), np.float32), np.zeros((0, limbs, 3), np.float32)
    assert len(implausible(BODY, *none, CHUNK)) == 0
    gone = np.full((2, limbs, 4), np.nan, np.float32), np.full((2, limbs, 3), np.nan, np.float32)
    np.testing.assert_array_equal(implausible(BODY, *gone, CHUNK), 1.0)
