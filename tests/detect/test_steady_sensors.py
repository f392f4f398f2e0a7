"""Sensors that move without a transform that says so, against scipy's rotations and rooms whose planes are known."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import voodoo_jax as vj
from tests.support.rooms import FLOOR, ORIGIN, box, figure, frame, grid, room
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.camera_motion import Planes, as_measured, steadied, steady_scene, to_fixed
from voodoo_jax.exporters.npz import write_tracks_npz
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.records.observation import whole
from voodoo_jax.records.recording import Pairs, Rays, Recording
from voodoo_jax.records.scene import Scene

WALL = Plane(np.array([-1, 0, 0], np.float32), -4.5)
ROOM = Scene(FLOOR, (WALL,), True)
TURN = np.array([0.02, -0.03, 0.04])  # radians about the sensor: roll, pitch, yaw
SHIFT = np.array([0.03, 0.0, -0.04])  # metres: not along the wall, which tells nothing of that


def swaying(count: int) -> list[tuple[Rotation, np.ndarray]]:
    """How a sensor turns and shifts from frame to frame, not at all in the first one."""
    share = np.sin(np.arange(count) * 0.4)
    return [(Rotation.from_rotvec(s * TURN), s * SHIFT) for s in share]


def shaken(points: np.ndarray, turn: Rotation, shift: np.ndarray) -> np.ndarray:
    """Points as a sensor has them that is elsewhere than it says."""
    return turn.apply(points - ORIGIN[0]) + ORIGIN[0] + shift


def inside(rng, i: int) -> np.ndarray:
    """A room, a desk, and somebody who walks."""
    return np.concatenate([room(rng), box(3.5, -1.0, 0.8, 0.7), figure(2.5, -0.5 + 0.02 * i)])


def test_points_come_to_lie_where_they_were(rng):
    clouds, ways = [inside(rng, i) for i in range(40)], swaying(40)
    frames = [frame(shaken(cloud, *way), i) for i, (cloud, way) in enumerate(zip(clouds, ways))]
    planes = Planes.of(ROOM, frames[:1])
    got = list(steadied(frames, planes))
    for cloud, (turn, _), before, after in zip(clouds, ways, frames, got):
        moved = turn.magnitude() > 0.02  # less is taken for noise
        assert (after.T_fixed_steady is not None) >= moved and (after is before) == (after.T_fixed_steady is None)
        assert np.abs(after.points - cloud).max() < (0.02 if after.T_fixed_steady is not None else 0.12)
        if after.T_fixed_steady is not None:
            T = after.T_fixed_steady
            assert (Rotation.from_matrix(T[:3, :3]) * turn.inv()).magnitude() < np.radians(0.3)
            np.testing.assert_allclose(after.origins, (ORIGIN - T[:3, 3]) @ T[:3, :3], atol=1e-5)
            np.testing.assert_allclose(as_measured(whole(after)).points, before.points, atol=2e-6)
    assert sum(f.T_fixed_steady is not None for f in got) > 30


@pytest.mark.parametrize("noise", [0.0, 0.006, 0.03])
def test_who_does_not_move_stays_as_it_is(rng, noise):
    still = [np.concatenate([room(rng, noise=noise), figure(2.5, -0.5 + 0.02 * i)]) for i in range(30)]
    frames = [frame(cloud, i) for i, cloud in enumerate(still)]
    assert all(a is b for a, b in zip(steadied(frames, Planes.of(ROOM, frames[:15:3])), frames))


def test_without_planes_nothing_is_known(rng):
    frames = [frame(shaken(figure(2.5, 0.0), *way), i) for i, way in enumerate(swaying(5))]
    planes = Planes.of(Scene(FLOOR, (), False), frames[:1])
    assert len(planes.offsets) == 0 and all(a is b for a, b in zip(steadied(frames, planes), frames))


def test_a_floor_alone_tells_what_is_level(rng):
    """How the sensor turns about the floor's normal remains."""
    floor = np.column_stack([grid((0.8, 4.5), (-1.6, 1.6), 0.04), np.zeros(93 * 80)])
    clouds = [np.concatenate([floor + rng.normal(0, 0.005, floor.shape), figure(2.5, 0.02 * i)]) for i in range(30)]
    frames = [frame(shaken(cloud, *way), i) for i, (cloud, way) in enumerate(zip(clouds, swaying(30)))]
    scene = Scene(FLOOR, (), True)
    for cloud, after in zip(clouds, steadied(frames, Planes.of(scene, frames[:1]))):
        assert np.abs(after.points[:, 2] - cloud[:, 2]).max() < 0.05
        assert np.abs(after.points - cloud).max() < 0.25


def test_a_frame_in_which_no_plane_is_seen_is_taken_to_be_like_the_last_one(rng):
    way = swaying(5)[4]
    frames = [frame(inside(rng, 0))] + [frame(shaken(inside(rng, 0), *way), i) for i in (1, 2)]
    frames += [
        frame(shaken(figure(2.5, 0.0, 1.7) + [0, 0, 0.5], *way), 3),
        frame(np.zeros((0, 3)), 4),
    ]
    got = [f.T_fixed_steady for f in steadied(frames, Planes.of(ROOM, frames[:1]))]
    assert got[0] is None and got[2] is not None
    for later in got[3:]:  # what nobody sees is slowly forgotten
        np.testing.assert_allclose(later, got[2], atol=0.003)


def test_a_wall_that_was_found_twice_is_one(rng):
    """Noise of several centimetres makes two planes of it, and neither is right."""
    scene = Scene(FLOOR, (replace(WALL, offset=-4.45), replace(WALL, offset=-4.53)), True)
    planes = Planes.of(scene, [frame(room(rng, noise=0.04), i) for i in range(5)])
    np.testing.assert_allclose(planes.offsets, [0.0, -4.5], atol=0.008)
    np.testing.assert_allclose(planes.noise, 0.04, rtol=0.25)


def test_rays_and_named_points_move_too(rng):
    ray = Rays(("face",), ORIGIN + np.float32(0.1), np.array([[1, 0, 0]], np.float32))
    pair = Pairs(("l_wrist",), np.array([[2.5, 0.2, 1.0]], np.float32))
    way = swaying(5)[4]
    seen = replace(frame(shaken(inside(rng, 0), *way), 1), rays=ray, pairs=pair)
    got = list(steadied([frame(inside(rng, 0)), seen], Planes.of(ROOM, [frame(inside(rng, 0))])))[1]
    T = got.T_fixed_steady
    assert T is not None
    np.testing.assert_allclose(got.rays.directions @ T[:3, :3].T, ray.directions, atol=1e-6)
    np.testing.assert_allclose(got.rays.origins @ T[:3, :3].T + T[:3, 3], ray.origins, atol=1e-5)
    np.testing.assert_allclose(got.pairs.points @ T[:3, :3].T + T[:3, 3], pair.points, atol=1e-5)


def test_poses_go_back_to_where_they_were_measured(rng):
    turned, place = Rotation.random(6, rng=rng), rng.normal(size=(2, 3, 3)).astype(np.float32)
    rotation = turned.as_quat(scalar_first=True).reshape(2, 3, 4).astype(np.float32)
    place[0, 1], rotation[0, 1] = np.nan, np.nan  # a limb that the body has not by now
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(TURN).as_matrix(), SHIFT
    people = [replace(whole(frame(figure(2, 0))), T_fixed_steady=T), whole(frame(figure(2, 0)))]
    before = rotation.copy(), place.copy()
    to_fixed(people, rotation, place)
    np.testing.assert_array_equal(rotation[1], before[0][1])
    np.testing.assert_array_equal(place[1], before[1][1])
    assert np.isnan(place[0, 1]).all() and np.isnan(rotation[0, 1]).all()
    for k in (0, 2):
        np.testing.assert_allclose(place[0, k], T[:3, :3] @ before[1][0, k] + T[:3, 3], atol=1e-6)
        wanted = Rotation.from_rotvec(TURN) * turned[k]
        assert (Rotation.from_quat(rotation[0, k], scalar_first=True) * wanted.inv()).magnitude() < 1e-5


def test_who_is_seen_by_a_camera_in_a_hand_is_tracked_as_from_a_tripod(tmp_path):
    """The demo, every frame of it turned and shifted about the camera: tracks turn and shift alike, and say how."""
    source = open_log(str(files("voodoo_jax") / "data" / "demo.mcap"))
    frames = [frame for frame, _ in zip(source.frames(), range(60))]
    ways = swaying(60)

    def move(points, f, turn, shift):
        return (turn.apply(points - f.origins[0]) + f.origins[0] + shift).astype(np.float32)

    def placed(f, way):
        directions = way[0].apply(f.rays.directions).astype(np.float32)
        rays = replace(f.rays, origins=move(f.rays.origins, f, *way), directions=directions)
        return replace(f, points=move(f.points, f, *way), rays=rays)

    def tracks(frames, settings):
        recorded = Recording("demo", source.fixed_frame, source.up, source.sensors, tuple(frames), source.features)
        return vj.track(vj.load_body("human"), recorded, settings)

    held = [placed(f, way) for f, way in zip(frames, ways)]
    still, moved = tracks(frames, Settings()), tracks(held, Settings())
    assert moved.tracked.all() and any("sensors move" in note for note in moved.notes)
    assert not any("sensors move" in note for note in still.notes)
    wanted = np.stack([move(joints, f, *way) for joints, f, way in zip(still.joints, frames, ways)])
    assert np.linalg.norm(moved.joints - wanted, axis=-1).mean() < 0.015
    write_tracks_npz(moved, tmp_path / "moved.tracks.npz")
    motion = vj.read_tracks(tmp_path / "moved.tracks.npz").T_fixed_steady
    assert motion is not None and still.T_fixed_steady is None and motion.shape == (60, 4, 4)
    # the height of a place that stands still, as the turned camera has it; the rest a floor alone does not tell
    height = [move(np.array([[2.5, 0, 1]]), f, *way)[0, 2] for f, way in zip(frames, ways)]
    assert np.ptp(height) > 0.05 and np.std((motion @ np.array([2.5, 0, 1, 1]))[:, 2] - height) < 0.01
    untold = replace(Settings(), detect=replace(Settings().detect, skip=("steady_sensors",)))
    assert not any("sensors move" in note for note in tracks(held, untold).notes)


def test_the_scene_is_found_while_the_camera_moves(rng):
    frames = [frame(shaken(inside(rng, i), *way), i) for i, way in enumerate(swaying(15))]
    scene, planes = steady_scene(frames, np.array([0, 0, 1], np.float32))
    assert scene.floor_seen and len(planes.offsets) == 2
    count = len(grid((0.8, 4.5), (-1.6, 1.6), 0.04))  # points of the floor come first
    for seen in steadied(frames, planes):
        off = seen.points[:count] @ planes.normals[0] - planes.offsets[0]
        assert np.sqrt(np.mean(off**2)) < 0.02
