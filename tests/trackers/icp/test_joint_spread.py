"""Joint covariances that know how far apart the passes there and back in time are."""

import numpy as np

from tests.support.segments import blank_tracks
from voodoo_jax.model.body_file import human
from voodoo_jax.solve import covariance
from voodoo_jax.trackers.icp.joint_spread import APART, NOISE, SHAPE, with_passes

BODY = human()
LIMBS, CENTRES = BODY.limb_count, len(BODY.topology.centres)


def tracks(apart: float):
    """Of joints that measurements alone let lie 2 cm off."""
    measured = 0.02**2 * np.diag([1.0, 2.0, 3.0])
    variance = (measured + covariance.SHAPE**2 * np.eye(3)).astype(np.float32)
    return blank_tracks(
        BODY, 3, joint_covariance=np.broadcast_to(variance, (3, CENTRES, 3, 3)),
        passes_apart=np.full((3, LIMBS), apart, np.float32),
    )  # fmt: skip


def test_passes_that_differ_widen_what_was_measured():
    measured = (NOISE / covariance.NOISE) ** 2 * 0.02**2 * np.diag([1.0, 2.0, 3.0])
    for apart in (0.0, 0.01, 0.2):
        found = with_passes(tracks(apart)).joint_covariance
        expected = measured + (SHAPE**2 + (APART * apart) ** 2) * np.eye(3)
        np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=1e-4, atol=1e-9)


def test_one_pass_leaves_a_limb_as_it_is():
    before = tracks(0.05)
    limb = BODY.topology.limbs.index("l_forearm")
    apart = before.evidence.passes_apart.copy()
    apart[:, limb] = np.nan
    after = with_passes(before.having(passes_apart=apart))
    mine = np.array(BODY.topology.centre_limbs) == limb
    assert mine.any()
    np.testing.assert_array_equal(after.joint_covariance[:, mine], before.joint_covariance[:, mine])
    assert (np.trace(after.joint_covariance[:, ~mine], axis1=2, axis2=3) != 0).all()
    assert not np.allclose(after.joint_covariance[:, ~mine], before.joint_covariance[:, ~mine])
