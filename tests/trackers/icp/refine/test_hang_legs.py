"""Legs that nobody saw: under somebody who leans, not in line with what leans."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.segments import blank_tracks
from voodoo_jax.config.options import TrackSettings
from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.icp.refine.hang_legs import long_hidden, with_hung_legs

BODY = scaled(human(), 1.8)
T = BODY.topology
LEGS = [T.limbs.index(f"{side}_{name}") for side in "lr" for name in ("thigh", "shank", "foot")]
UP = np.array([0, 0, 1], np.float32)
FRAMES = 61  # at 20 Hz


def leaning(degrees: float, seen: list[str], heading: float = 0.0) -> Tracks:
    """The rest pose, leaning forwards as a whole, of which only some limbs are seen."""
    turn = Rotation.from_euler("zy", [heading, degrees], degrees=True)
    rotation = (turn * Rotation.from_quat(np.asarray(BODY.rest.rotation), scalar_first=True)).as_quat(scalar_first=True)
    each = lambda values: np.repeat(np.asarray(values, np.float32)[None], FRAMES, 0)  # noqa: E731
    poses = Poses(each(rotation), each(turn.apply(np.asarray(BODY.rest.translation))))
    weight = np.tile([100.0 * (name in seen) for name in T.limbs], (FRAMES, 1)).astype(np.float32)
    joints = np.asarray(apply(poses[:, np.array(T.centre_limbs, int)], np.asarray(BODY.centres)), np.float32)
    time = 10**18 + 50_000_000 * np.arange(FRAMES)
    return blank_tracks(BODY, FRAMES).having(
        rotation=poses.rotation, translation=poses.translation, joints=joints,
        limb_weight=weight, time_ns=time, up=UP,
    )  # fmt: skip


def place(tracks: Tracks, name: str, frame: int = 30) -> np.ndarray:
    return tracks.joints[frame, T.centres.index(name)]


UPPER = [name for name in T.limbs if name.split("_")[-1] not in ("thigh", "shank", "foot")]


@pytest.mark.parametrize("heading", [0.0, 130.0])
def test_shanks_below_the_picture_stay_under_who_bows(heading):
    before = leaning(40.0, [*UPPER, "l_thigh", "r_thigh"], heading)
    after = with_hung_legs(before, TrackSettings())
    ahead = Rotation.from_euler("z", heading, degrees=True).apply([1.0, 0, 0])
    for side in "lr":
        shank = place(after, f"{side}_talocrural") - place(after, f"{side}_knee")
        old = place(before, f"{side}_talocrural") - place(before, f"{side}_knee")
        np.testing.assert_allclose(np.linalg.norm(shank), np.linalg.norm(old), atol=1e-4)
        assert -0.5 < shank @ ahead / np.linalg.norm(shank) < -0.1 and shank[2] < 0
        np.testing.assert_allclose(place(after, f"{side}_knee"), place(before, f"{side}_knee"), atol=0.01)
    others = [k for k in range(len(T.limbs)) if k not in LEGS]
    np.testing.assert_array_equal(after.rotation[:, others], before.rotation[:, others])


def test_thighs_hang_from_who_bows_and_not_from_who_lies():
    bows, lies = leaning(50.0, UPPER), leaning(90.0, UPPER)
    hung = with_hung_legs(bows, TrackSettings())
    assert place(hung, "l_knee")[2] < place(bows, "l_knee")[2] - 0.05
    np.testing.assert_allclose(with_hung_legs(lies, TrackSettings()).joints, lies.joints, atol=1e-4)


def test_what_was_seen_stays():
    for seen in (list(T.limbs), [*UPPER, "l_foot", "r_foot"]):
        tracks = leaning(40.0, seen)
        assert with_hung_legs(tracks, TrackSettings()) is tracks
    assert with_hung_legs(tracks := leaning(40.0, UPPER), TrackSettings(hidden_rest=0.0)) is tracks


def test_how_long_a_limb_is_hidden_counts():
    shown = np.ones(FRAMES)
    shown[20:41] = 0
    much = long_hidden(shown, 50_000_000 * np.arange(FRAMES), 0.8)
    assert much[:20].max() == 0 and much[41:].max() == 0
    np.testing.assert_allclose(much[[20, 30, 40]], 1 - np.exp(-np.array([0.05, 0.55, 0.05]) / 0.8), atol=1e-6)
    assert long_hidden(0 * shown, np.arange(FRAMES), 0.8).min() == 1
