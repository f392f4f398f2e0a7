"""Smoothing of finished tracks: less noise, no delay, nothing across gaps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from voodoo_jax.model.body_file import human
from voodoo_jax.records.tracks import Evidence, Status, Tracks
from voodoo_jax.trackers.smoothing import smooth

BODY = human()
JOINTS, LIMBS = len(BODY.topology.centres), BODY.limb_count


def tracks_of(joints, angles, rate=30.0) -> Tracks:
    """Tracks with given joints and all limbs turned about x by `angles`, radians."""
    n = len(joints)
    q = Rotation.from_euler("x", np.asarray(angles)[:, None]).as_quat(scalar_first=True)
    return Tracks(
        source="", fixed_frame="base", body=BODY, time_ns=(10**18 + np.arange(n) * 1e9 / rate).astype(np.int64),
        rotation=np.repeat(q[:, None], LIMBS, 1).astype(np.float32),
        translation=np.repeat(joints[:, :1], LIMBS, 1).astype(np.float32), joints=joints.astype(np.float32),
        status=np.full(n, Status.TRACKED, np.int8), evidence=Evidence.blank(n, LIMBS),
    )  # fmt: skip


def line(n, velocity=(1.0, -2.0, 0.5)):
    return np.repeat((np.arange(n)[:, None] / 30 * np.array(velocity))[:, None], JOINTS, 1)


def test_steady_motion_stays_as_it_is_at_the_ends_too():
    given = tracks_of(line(40), np.linspace(0, 0.3, 40))
    found = smooth(given, 0.1)
    np.testing.assert_allclose(found.joints, given.joints, atol=1e-5)
    np.testing.assert_allclose(found.translation, given.translation, atol=1e-5)
    turned = Rotation.from_quat(found.rotation[:, 0], scalar_first=True).as_rotvec()[:, 0]
    np.testing.assert_allclose(turned, np.linspace(0, 0.3, 40), atol=2e-3)


def test_noise_becomes_less():
    rng = np.random.default_rng(0)
    clean = line(200)
    found = smooth(tracks_of(clean + rng.normal(0, 0.01, clean.shape), rng.normal(0, 0.05, 200)), 0.067)
    assert np.std(found.joints - clean) < 0.006
    assert np.std(Rotation.from_quat(found.rotation[:, 3], scalar_first=True).as_rotvec()) < 0.03
    np.testing.assert_allclose(np.linalg.norm(found.rotation, axis=-1), 1, atol=1e-6)


def test_the_sign_of_a_quaternion_does_not_matter():
    given = tracks_of(line(30), np.linspace(2.9, 3.4, 30))
    flipped = given.rotation.copy()
    flipped[::3] *= -1
    a, b = smooth(given, 0.067), smooth(replace(given, rotation=flipped), 0.067)
    np.testing.assert_allclose(np.abs((a.rotation * b.rotation).sum(-1)), 1, atol=1e-6)


def test_nothing_is_smoothed_across_gaps_or_invented():
    joints = line(40, (0, 0, 0))
    joints[20:] += 1.0
    joints[18:20] = np.nan
    found = smooth(tracks_of(joints, np.zeros(40)), 0.2)
    np.testing.assert_array_equal(np.isnan(found.joints), np.isnan(joints))
    assert np.nanmax(np.abs(found.joints - joints)) < 1e-6
    late = tracks_of(line(40, (0, 0, 0)) + (np.arange(40) >= 20)[:, None, None], np.zeros(40))
    stamps = late.time_ns + (np.arange(40) >= 20) * 600_000_000
    assert np.abs(smooth(replace(late, time_ns=stamps), 0.3).joints - late.joints).max() < 1e-6


def test_no_width_changes_nothing_and_a_negative_one_is_refused():
    given = tracks_of(line(5), np.zeros(5))
    assert smooth(given, 0.0) is given
    with pytest.raises(ValueError, match="negative"):
        smooth(given, -1.0)
    one = tracks_of(line(1), np.zeros(1))
    np.testing.assert_array_equal(smooth(one, 0.1).joints, one.joints)
