"""Which way is up where the log does not say: cameras on their side, on their head, looking down."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import voodoo_jax.detect.find_gravity
from tests.support.logs import depth_log
from tests.support.rooms import FLOOR, box, build_of, figure, frame, room
from voodoo_jax.config.options import DetectSettings, ReadSettings, Settings, SettingsError
from voodoo_jax.detect.find_gravity import upright
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.detect.scene import find_scene, shows_floor
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body_file import load_on_host
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

BODY, UP = build_of(), np.array([0, 0, 1], np.float32)


def turned(points, way: Rotation) -> np.ndarray:
    """What a camera sees that is turned about its place, in its own frame."""
    return way.inv().apply(points - [0, 0, 1.2]).astype(np.float32)


def seen(points, i: int) -> Frame:
    return Frame(i, points, np.zeros(len(points), np.int32), np.zeros((1, 3), np.float32))


def found(clouds, up, sure: bool = False) -> np.ndarray:
    frames = [seen(cloud, i) for i, cloud in enumerate(clouds)]
    return upright(frames, find_scene(frames, up, sure), up, sure, BODY, DetectSettings())


WAYS = {
    "as it should be": Rotation.identity(),
    "a little tilted": Rotation.from_euler("xy", [15, 20], degrees=True),
    "on one side": Rotation.from_euler("x", 90, degrees=True),
    "on the other side": Rotation.from_euler("xy", [-80, 10], degrees=True),
    "on its head": Rotation.from_euler("x", 180, degrees=True),
}


@pytest.mark.parametrize(("way", "sure"), [(w, s) for w in WAYS for s in (True, False) if not (s and "head" in w)])
def test_up_is_where_somebody_stands_on_a_floor(rng, way, sure):
    """Whatever the log says of it; to 40 degrees, and then the floor's normal is."""
    clouds = [turned(np.concatenate([room(rng), figure(2.5, 0.1 * i)]), WAYS[way]) for i in range(3)]
    up = found(clouds, UP, sure)
    true = WAYS[way].inv().apply(UP)
    assert up @ true > np.cos(np.radians(40))
    scene = find_scene([seen(clouds[0], 0)], up, False)
    assert scene.floor_seen and scene.floor.normal @ true > np.cos(np.radians(1))


def test_a_camera_at_the_ceiling_looks_down(rng):
    """Level in its own frame is down in the room."""
    way = Rotation.from_euler("y", 75, degrees=True)
    floor = room(rng)
    clouds = [way.inv().apply(np.concatenate([floor[floor[:, 2] < 0.1], figure(2.0, 0.0)]) - [1.2, 0, 3.0])] * 3
    up = found([cloud.astype(np.float32) for cloud in clouds], UP)
    assert up @ way.inv().apply(UP) > np.cos(np.radians(40))


def test_where_nobody_is_nothing_else_is_taken_for_up(rng):
    """A wall beside an empty room is no floor."""
    for way in WAYS.values():
        assert found([turned(room(rng), way)] * 3, UP) is UP
    assert found([np.zeros((0, 3), np.float32)] * 3, UP) is UP
    assert upright([], find_scene([], UP), UP, False, BODY, DetectSettings()) is UP


def test_somebody_before_a_wall_without_floor_is_as_the_frame_says():
    """And a wall without any noise is one."""
    side = turned(box(4.0, 0.0, 4.0, 2.5), Rotation.identity())
    person = turned(figure(2.5, 0.0), Rotation.identity())
    assert found([np.concatenate([side, person])] * 3, UP) is UP


def test_who_is_found_at_once_costs_one_look(rng, monkeypatch):
    looks = []
    finder = voodoo_jax.detect.find_gravity.BodySegmenter
    monkeypatch.setattr(voodoo_jax.detect.find_gravity, "BodySegmenter", lambda *a: looks.append(a) or finder(*a))
    frames = [frame(np.concatenate([room(rng), figure(2.5, 0.0)]), i) for i in range(3)]
    for sure, count in ((True, 0), (False, 1)):  # who is sure and has a floor needs none
        assert upright(frames, Scene(FLOOR, (), True), UP, sure, BODY, DetectSettings()) is UP and len(looks) == count


def test_a_child_before_a_wall_does_not_lie_on_it(rng):
    """Seen from above it would stand on the wall."""
    clouds = [np.concatenate([room(rng, wall=3.2), figure(2.4 + 0.02 * i, 0.3, 1.05, 0.12)]) for i in range(3)]
    clouds = [turned(cloud, Rotation.identity()) for cloud in clouds]
    assert found(clouds, UP, sure=True) is UP and found(clouds, UP) is UP


def test_a_floor_is_seen_from_any_side_that_is_told(rng):
    cloud = room(rng)
    cloud = cloud[cloud[:, 2] < 0.1].astype(np.float32)
    assert shows_floor(frame(cloud), UP)
    assert not shows_floor(frame(room(rng)), -UP)
    assert not shows_floor(frame(cloud[:10]), UP) and not shows_floor(frame(cloud[:0]), UP)


OPTICAL = Rotation.from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))  # x right, y down, z forward
Y_UP = Rotation.from_euler("x", 90, degrees=True)


@pytest.mark.parametrize("sure", [True, False])
@pytest.mark.parametrize("way", [OPTICAL, OPTICAL * Rotation.from_euler("z", 180, degrees=True), Y_UP])
def test_a_frame_whose_z_is_not_up_is_found_by_its_floor(rng, way, sure):
    """Cameras whose frames look along z whatever they are called, on their head too, and laboratories with y up."""
    clouds = [turned(np.concatenate([room(rng), figure(2.5, 0.1 * i)]), way) for i in range(3)]
    assert found(clouds, UP, sure) @ way.inv().apply(UP) > np.cos(np.radians(40))


def test_what_a_user_says_of_up_is_not_looked_for(rng, tmp_path):
    clouds = [turned(np.concatenate([room(rng), figure(2.5, 0.1 * i)]), OPTICAL) for i in range(3)]
    frames = [seen(cloud, i * 33_000_000) for i, cloud in enumerate(clouds)]
    scene, _ = find_body(frames, UP, load_on_host("human"), Settings())
    assert scene.floor.normal @ [0, -1, 0] > 0.99 and "read.up" in " ".join(scene.notes)
    scene, people = find_body(frames, UP, load_on_host("human"), Settings(), up_is_given=True)
    assert scene.floor.normal @ UP > 0.7 and not scene.notes
    log = depth_log(1).write(tmp_path / "a.mcap")
    recording = read_log(log, ReadSettings(up="-y"))
    assert recording.up_is_given and recording.up.tolist() == [0, -1, 0]
    with pytest.raises(SettingsError, match="read.up"):
        read_log(log, ReadSettings(up="upwards"))
