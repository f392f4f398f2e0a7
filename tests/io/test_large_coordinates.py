"""Coordinates of a country: computed near a local origin, written in the asked frame without loss."""

from dataclasses import replace

import numpy as np

from tests.support.logs import HALF, PERIOD, START, Log, depth_log, ros_marker, ros_markers, ros_tf
from tests.support.small_logs import SETTINGS, small_body, small_log
from voodoo_jax.batch.log_job import track_log
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.exporters.npz import read_tracks_npz, write_tracks_npz
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.records.tracks import given_from
from voodoo_jax.trackers.smoothing import smooth

TOKYO = 388108.25, 3949003.5, 12.0
TURNED = 0.0, 0.0, HALF, HALF


def utm(log: Log) -> Log:
    return log.add("/tf_static", START, ros_tf((START, "utm", "base", TOKYO, TURNED)))


def test_points_and_features_are_read_from_a_near_origin(tmp_path):
    near = read_log(depth_log(2).write(tmp_path / "a.mcap"))
    log = utm(depth_log(2))
    log.add("/markers", START, ros_markers(ros_marker(START, "base", "wrist", (1.0, 0.5, 1.0))))
    far = read_log(log.write(tmp_path / "b.mcap"))
    assert far.fixed_frame == "utm" and "float64" in " ".join(far.notes)
    np.testing.assert_array_equal(far.origin, [388108.0, 3949004.0, 0.0])  # height is kept: z = 0 may be the floor
    turn = lambda p: np.column_stack([-p[:, 1], p[:, 0], p[:, 2]]) + TOKYO  # noqa: E731
    for a, b in zip(near, far):
        np.testing.assert_allclose(b.points + far.origin, turn(a.points.astype(float)), atol=1e-5)
        np.testing.assert_allclose(b.origins + far.origin, turn(a.origins.astype(float)), atol=1e-5)
    np.testing.assert_allclose(far.frames[0].pairs.points + far.origin, turn(np.array([[1.0, 0.5, 1.0]])), atol=1e-5)
    asked = read_log(tmp_path / "b.mcap", ReadSettings(fixed_frame="base"))
    np.testing.assert_array_equal(asked.frames[0].points, near.frames[0].points)
    assert not asked.origin.any()


def test_markers_without_a_transform(tmp_path):
    log = Log()
    for i in range(3):
        stamp = START + i * PERIOD
        log.add("/m", stamp, ros_markers(ros_marker(stamp, "map", "wrist", (5e5 + 0.001 * i, 2.0, 1.0))))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    places = np.concatenate([frame.pairs.points + recording.origin for frame in recording])
    np.testing.assert_allclose(places[:, 0], 5e5 + 0.001 * np.arange(3), atol=1e-6)


def test_tracks_are_the_same_at_another_place(tmp_path):
    (near,) = track_log(small_log(tmp_path / "a.mcap", 6), small_body(), SETTINGS)
    far = given_from(near, np.array(TOKYO))
    assert far.joints.dtype == np.float64 and near.joints.dtype == np.float32
    path = tmp_path / "a.tracks.npz"
    write_tracks_npz(smooth(far, 0.1), path)
    np.testing.assert_allclose(read_tracks_npz(path).joints - TOKYO, smooth(near, 0.1).joints, atol=1e-6)
    assert given_from(near, np.zeros(3)) is near
    back = replace(given_from(far, -np.array(TOKYO)), joints=near.joints)
    np.testing.assert_allclose(back.translation, near.translation, atol=1e-8)
