"""The flexible tracker on a simulated colour and depth camera: it finds and follows, the same seed gives the same bits,
and what it cannot take is refused in a sentence."""

from dataclasses import replace

import numpy as np
import pytest

import voodoo_jax as vj
from tests.support.colour_logs import Board, picture, ros_compressed, ros_info
from tests.support.logs import PERIOD, START, Log, depth_log
from tests.support.waving import CAMERA, SMALL, waving_log
from voodoo_jax.batch.log_job import track_log
from voodoo_jax.config.options import ReadSettings, Settings
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import with_proportions
from voodoo_jax.records.recording import Recording
from voodoo_jax.sensors.quick_stereo import quick_depth
from voodoo_jax.simulate.colour import simulate_colour
from voodoo_jax.simulate.mcap import write_colour
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import NO_NOISE
from voodoo_jax.trackers.base import Unsuitable

FRAMES = 28


@pytest.fixture(scope="module")
def waving(tmp_path_factory) -> tuple[Recording, np.ndarray]:
    """A person who waves before a colour and depth camera, and the true joint centres."""
    path, joints = waving_log(tmp_path_factory.mktemp("colour"), FRAMES)
    return read_log(path, vj.preset("flexible").read), joints


def test_it_follows_a_person_and_the_same_seed_gives_the_same_bits(waving):
    recording, truth = waving
    settings = Settings(tracker="flexible", flexible=SMALL)
    tracks = vj.track(vj.human(), recording, settings)
    error = np.linalg.norm(tracks.joints - truth, axis=-1)
    assert np.nanmean(error[3:]) < 0.08 and np.isfinite(error).all()
    assert abs(float(tracks.body.scale) - 1.7) < 0.08
    assert tracks.joint_confidence is not None and tracks.tracked.mean() > 0.8
    # limbs lie where their joints are
    shoulder = tracks.joint("l_shoulder")
    upper = tracks.body.topology.limbs.index("l_upper_arm")
    assert np.linalg.norm(tracks.translation[:, upper] - shoulder, axis=1).max() < 0.15
    again = vj.track(vj.human(), recording, replace(settings, tracker="icp"), tracker="flexible")
    other = vj.track(vj.human(), recording, replace(settings, flexible=replace(SMALL, seed=1)))
    np.testing.assert_array_equal(tracks.joints, again.joints)
    assert not np.array_equal(tracks.joints, other.joints)


def test_recordings_of_one_batch_are_as_each_alone(waving):
    """To the last bit, whatever is beside it."""
    recording, _ = waving
    settings = Settings(tracker="flexible", flexible=SMALL)
    shorter = replace(recording, frames=recording.frames[:10])
    together = vj.track_many(vj.human(), [recording, shorter], settings, quiet=True)
    for own, tracks in zip((recording, shorter), together):
        alone = vj.track(vj.human(), own, settings)
        for name in ("joints", "joint_confidence", "rotation", "status"):
            np.testing.assert_array_equal(getattr(tracks, name), getattr(alone, name))
    assert len(together[1].joints) == 10


def test_what_it_cannot_take_is_refused(waving, tmp_path):
    recording, _ = waving
    blind = replace(recording, frames=tuple(replace(f, pictures=()) for f in recording.frames))
    with pytest.raises(Unsuitable, match="--tracker icp"):
        vj.track(vj.human(), blind, tracker="flexible")
    with pytest.raises(Unsuitable, match="follows people"):
        vj.track(vj.load_body("dog"), recording, tracker="flexible")
    with pytest.raises(Unsuitable, match="no images.*--tracker icp"):
        track_log(depth_log().write(tmp_path / "d.mcap"), vj.human(), Settings(tracker="flexible"))
    for free, folds in (("bands", 0), ("lengths", 2)):
        options = vj.FitSettings(free=(free,), folds=folds)
        with pytest.raises(ValueError, match="tracker.* icp"):
            vj.fit(vj.human(), [recording] * 2, Settings(tracker="flexible"), options)


def test_sizes_are_fitted(waving):
    """The right body is found to be right, one with arms too short by a tenth gets longer ones."""
    recording, _ = waving
    arms = {f"{side}_{part}": 0.9 for side in "lr" for part in ("upper_arm", "forearm")}
    short = with_proportions(vj.human(), arms)
    settings = Settings(tracker="flexible", flexible=SMALL)
    options = vj.FitSettings(free=("lengths.*arm",), frames=9, points=128, iterations=4, noise=0.015)
    right, wrong = (vj.fit(body, [recording], settings, options) for body in (vj.human(), short))
    assert not right.better and np.abs(right.x).max() < 0.05
    assert wrong.x[wrong.names.index("lengths.upper_arm")] > 0.02
    assert np.isfinite(wrong.sd).all() and wrong.losses[-1] < wrong.losses[0]
    assert any(size.name == "upper_arm" and size.after > size.before for size in wrong.sizes[0])


K = np.array([[400.0, 0.0, 159.5], [0.0, 400.0, 119.5], [0.0, 0.0, 1.0]])
BOARDS, SIZE = [Board(4.0), Board(2.5, (-0.4, -0.5), (0.3, 0.4))], (240, 320)


def test_images_come_with_frames_only_where_they_are_asked_for(tmp_path):
    log = Log()
    log.add("/rig/left/camera_info", START, ros_info("left_optical", K, SIZE))
    log.add("/rig/right/camera_info", START, ros_info("right_optical", K, SIZE, p03=-48.0))
    views = [picture(BOARDS, K, SIZE, (x, 0, 0)) for x in (0.0, 0.12)]
    for i in range(2):
        for side, image in zip(("left", "right"), views):
            stamp = START + i * PERIOD
            name = f"/rig/{side}/image_raw/compressed"
            log.add(name, stamp, ros_compressed(stamp, f"{side}_optical", image, ".png", "png"))
    path = log.write(tmp_path / "pair.mcap")
    assert not any(f.pictures for f in read_log(path))
    frames = read_log(path, ReadSettings(images=True, matching="none")).frames
    assert len(frames) == 2 and all(len(f.points) == 0 and len(f.pictures) == 1 for f in frames)
    shot = frames[1].pictures[0]
    assert shot.baseline == pytest.approx(0.12) and shot.K[0, 0] == pytest.approx(400)
    left, right = shot.unpack()
    np.testing.assert_array_equal(left, views[0])
    z = quick_depth(left, right, 48.0, 0.0, 1.0)[20:-20, 40:-20]
    box = z[20:50, 20:50]
    assert (z > 0).mean() > 0.8 and abs(np.median(box[box > 0]) - 2.5) < 0.03
    assert abs(np.median(z[:, 75:][z[:, 75:] > 0]) - 4.0) < 0.06


def test_a_second_camera_sees_the_face_and_the_arm_that_the_first_one_does_not(tmp_path):
    """One beside a person whose far arm waves, one before them; both have depth."""
    body = vj.human()
    motion = placed(make_motion(body, "wave", 22 / 15, 15.0), 2.6, 0.0, np.pi)
    front, side = CAMERA, replace(CAMERA, position=(2.6, 2.6, 1.2), yaw=-np.pi / 2)
    empty = Room(wall=None, boxes=())
    beside, before = (simulate_colour(body, motion, (c,), c, room=empty, noise=NO_NOISE) for c in (side, front))
    both = write_colour(beside, tmp_path / "both.mcap", beside=[before])
    recording = read_log(both, vj.preset("flexible").read)
    frame = recording.frames[3]
    assert len(frame.pictures) == 2 and len(frame.origins) == 2 and set(frame.sensor.tolist()) == {0, 1}
    settings = Settings(tracker="flexible", flexible=SMALL)
    tracks = vj.track(body, recording, settings)
    assert not any("No face" in note for note in tracks.notes)
    error = np.linalg.norm(tracks.joints - beside.joints, axis=-1)
    assert np.nanmean(error[3:]) < 0.05
    # the other camera stops: what it last saw is not taken for what it sees
    left = lambda f: tuple(p for p in f.pictures if p.topic.startswith("/camera2"))  # noqa: E731
    gone = [f if i < 10 else replace(f, pictures=left(f)) for i, f in enumerate(recording.frames)]
    stopped = vj.track(body, replace(recording, frames=tuple(gone)), settings)
    error = np.linalg.norm(stopped.joints - beside.joints, axis=-1)
    assert np.nanmean(error[3:]) < 0.05
