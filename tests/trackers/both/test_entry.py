"""Both trackers together on a simulated colour and depth camera, and what is said where they cannot be."""

from dataclasses import replace

import numpy as np
import pytest

import voodoo_jax as vj
from tests.support.logs import depth_log
from tests.support.waving import SMALL, waving_log
from voodoo_jax.batch.log_job import track_log
from voodoo_jax.config.options import Change, Settings
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.records.recording import Recording
from voodoo_jax.trackers.base import Unsuitable
from voodoo_jax.trackers.both.entry import NOBODY

FRAMES = 20


@pytest.fixture(scope="module")
def waving(tmp_path_factory) -> tuple[Recording, np.ndarray]:
    """A person who waves before a colour and depth camera, and the true joint centres."""
    path, joints = waving_log(tmp_path_factory.mktemp("colour"), FRAMES)
    return read_log(path, vj.preset("both").read), joints


def test_both_together_are_between_the_two_and_say_what_they_are(waving):
    recording, truth = waving
    settings = replace(vj.preset("both"), flexible=SMALL)
    error = lambda tracks: np.linalg.norm(tracks.joints[3:] - truth[3:], axis=-1)  # noqa: E731
    alone = [vj.track(vj.human(), recording, settings, tracker=name) for name in ("icp", "flexible")]
    both = vj.track(vj.human(), recording, settings)
    again = vj.track(vj.human(), recording, Settings(flexible=SMALL), tracker="both")
    np.testing.assert_array_equal(both.joints, again.joints)
    means = [error(tracks).mean() for tracks in alone]
    assert error(both).mean() < np.mean(means) and error(both).mean() < 0.05
    assert both.tracked.all() and both.joint_confidence is not None and both.joint_covariance is not None
    assert abs(both.joint_confidence[3:].mean() - (error(both) < 0.1).mean()) < 0.1
    for name in ("limb_distance", "depth_inside", "beyond_limits", "rotation", "translation"):
        each = both.rows()[name]
        assert np.isfinite(each).all() and len(each) == len(recording.frames)
    assert both.seconds > alone[0].seconds / 2 and both.body.scale == alone[0].body.scale


def test_a_log_without_images_is_refused_in_one_sentence(waving, tmp_path):
    recording, _ = waving
    blind = replace(recording, frames=tuple(replace(f, pictures=()) for f in recording.frames))
    with pytest.raises(Unsuitable, match=r"no images.*vj.preset\('both'\).*--tracker icp"):
        vj.track(vj.human(), blind, tracker="both")
    with pytest.raises(Unsuitable, match="no images.*--tracker icp"):
        track_log(depth_log().write(tmp_path / "d.mcap"), vj.human(), Settings(tracker="both"))


def test_what_one_of_both_does_not_know_is_refused(waving):
    recording, _ = waving
    with pytest.raises(Unsuitable, match="follows people"):
        vj.track(vj.load_body("dog"), recording, tracker="both")
    for tracker in ("both", "flexible"):
        with pytest.raises(Unsuitable, match=r"\[\[change\]\].*--tracker icp"):
            vj.track(vj.human(), recording, Settings(tracker=tracker, changes=(Change(time=1.0, scale=1.7),)))
    with pytest.raises(ValueError, match="icp or flexible"):
        vj.fit(vj.human(), [recording], Settings(tracker="both"))


def test_where_nobody_stands_nobody_is_found(waving):
    recording, _ = waving
    far = tuple(replace(f, points=f.points[:5], sensor=f.sensor[:5]) for f in recording.frames)
    tracks = vj.track(vj.human(), replace(recording, frames=far), replace(vj.preset("both"), flexible=SMALL))
    assert not tracks.tracked.any() and NOBODY in tracks.notes
