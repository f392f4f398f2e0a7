"""Which way is up of named points: by who stands, whatever the log says, while who lies stays lying."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.segments import blank_tracks
from voodoo_jax.kernels.landmarks import named_points
from voodoo_jax.markers.table import places
from voodoo_jax.markers.upward import with_upward
from voodoo_jax.model.body_file import human
from voodoo_jax.records.tracks import Status
from voodoo_jax.simulate.motion import make_motion, placed, pose_body

RATE = 30.0
Z = np.array([0.0, 0, 1])
Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def tracks_of(name, turn, shift=(0.0, 0, 0), noise=0.0):
    """Tracks of somebody who does something at the origin of a floor, all of it turned and shifted."""
    body = human()
    motion = make_motion(body, name, 3.0, RATE)
    poses = pose_body(body, placed(motion, 0.0, 0.0, 0.0).root, motion.rotations)
    count = len(body.topology.centres)
    rows = np.arange(len(named_points(body)[0]))[-count:]
    joints = places(body, rows, poses) @ np.asarray(turn).T + np.asarray(shift)
    joints = joints + np.random.default_rng(0).normal(0, noise, joints.shape)
    status = np.full(len(joints), Status.TRACKED, np.int8)
    time_ns = np.round(np.arange(len(joints)) / RATE * 1e9).astype(np.int64)
    seen = np.ones((len(joints), body.limb_count), np.float32)
    arrays = {"joints": joints.astype(np.float32), "status": status, "time_ns": time_ns, "limb_weight": seen}
    return blank_tracks(body, len(joints), **arrays)


def found(tracks, told=Z):
    one = with_upward([tracks], np.asarray(told, float))[0]
    assert (one.up is not None) == any("read.up" in note for note in one.notes)
    return told if one.up is None else one.up


@pytest.mark.parametrize("name", ["walk", "bow", "stand"])
def test_who_stands_tells_it(name):
    np.testing.assert_allclose(found(tracks_of(name, Y_UP)), [0, 1, 0])
    np.testing.assert_allclose(found(tracks_of(name, np.eye(3))), Z)
    np.testing.assert_allclose(found(tracks_of(name, Y_UP), [0.0, 1, 0]), [0, 1, 0])
    # a zero that is not on the floor, and the noise of a skeleton from depth
    np.testing.assert_allclose(found(tracks_of(name, Y_UP, (3.0, 0.7, 0.5), 0.01)), [0, 1, 0])


def test_a_camera_that_is_tilted_has_no_axis_upwards():
    optical = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    turn = Rotation.from_euler("x", 25, degrees=True).as_matrix() @ optical
    up = found(tracks_of("walk", turn, (0.0, 1.2, 3.0)))
    assert up @ turn[:, 2] > np.cos(np.radians(6))


def test_who_runs_leaning_goes_along_the_floor():
    """As from starting blocks: the body lies nearly along the way that it goes."""
    lean = Rotation.from_euler("y", 65, degrees=True).as_matrix()
    start = tracks_of("walk", np.eye(3))
    along = np.linspace(0, 4, len(start.joints))[:, None, None] * [1, 0, 0]
    own = start.joints.mean(1, keepdims=True)
    leaning = (start.joints - own) @ lean.T + [0, 0, 0.5] + along
    leaning[70:] = start.joints[70:]
    up = found(replace(start, joints=(leaning @ Y_UP.T).astype(np.float32)))
    np.testing.assert_allclose(up, [0, 1, 0])


def test_who_lies_stays_lying():
    """On the floor of a laboratory, supine; and on a bed, where the legs move."""
    flat = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])  # up to along x, ahead to up
    on_floor = tracks_of("stand", flat, (2.0, 1.0, 0.12))
    np.testing.assert_allclose(found(on_floor), Z)
    on_bed = tracks_of("stand", flat, (2.0, 1.0, 0.6))
    centres, wave = on_bed.body.topology.centres, 0.2 * np.sin(np.arange(len(on_bed.time_ns)) / 5)
    for side in "lr":
        on_bed.joints[:, centres.index(f"{side}_talocrural"), 2] += wave
    np.testing.assert_allclose(found(on_bed), Z)


def test_who_gets_up_says_what_is_up():
    lying = tracks_of("stand", np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]), (2.0, 1.0, 0.12))
    up = tracks_of("walk", np.eye(3))
    assert all(one.up is None for one in with_upward([lying, up], Z))
