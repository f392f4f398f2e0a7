"""Simulated recordings: kinematics, ray casting against trimesh, noise, files."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tests.support.truth import truth_tracks
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import bands, scaled, segment_lengths, with_proportions
from voodoo_jax.model.body_file import load_body
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import MOTIONS, make_motion, placed, pose_body, sequence
from voodoo_jax.simulate.recording import render, simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import (
    KINECT_NOISE,
    NO_NOISE,
    TOF_NOISE,
    Camera,
    Noise,
    add_noise,
    kinect_camera,
    tof_camera,
)

SMALL = Camera(40, 31, 45.5, 43.1, 19.5, 15.0, (0.0, 0.0, 1.2), 0.07)


def turn_matrices(poses: Poses) -> np.ndarray:
    q = np.asarray(poses.rotation, float)
    return Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_matrix().reshape(*q.shape[:-1], 3, 3)


def in_world(body, poses, limbs, points) -> np.ndarray:
    """Points [joint, ..., 3] of the limbs [joint] in the frame of one set of poses."""
    turn, at = turn_matrices(poses)[list(limbs)], np.asarray(poses.translation, float)[list(limbs)]
    return np.einsum("jab,jkb->jka", turn, np.asarray(points, float)) + at[:, None]


def tiny(body_name="human", motion="wave", **kwargs):
    body = load_body(body_name)
    moved = placed(make_motion(body, motion, 0.6, 10.0), 2.5, 0.0, np.pi)
    return simulate(body, moved, **{"camera": SMALL, "seed": 3, **kwargs})


@pytest.mark.parametrize("name", ["human", "human10", "arm", "dog"])
def test_rest_pose_is_zero_rotation(name):
    body = load_body(name)
    poses = pose_body(body, body.rest[0], np.zeros((len(body.topology.joints), 3)))
    np.testing.assert_allclose(poses.translation, body.rest.translation, atol=2e-6)
    np.testing.assert_allclose(turn_matrices(poses), turn_matrices(body.rest), atol=2e-6)


@pytest.mark.parametrize("name", ["human", "human10", "arm", "dog"])
def test_anchors_stay_together(name):
    body = load_body(name)
    rotations = np.random.default_rng(0).normal(0, 0.7, (len(body.topology.joints), 3))
    poses = pose_body(body, body.rest[0], rotations)
    parent = in_world(body, poses, body.topology.parents, body.parent_anchor.translation[:, None])
    child = in_world(body, poses, body.topology.children, body.child_anchor.translation[:, None])
    np.testing.assert_allclose(parent, child, atol=5e-6)


@pytest.mark.parametrize("name", ["human", "arm"])
def test_motions_keep_hinges_closed(name):
    """No motion tears a hinge's bands: its rotation is about the hinge's axis only."""
    body = load_body(name)
    band = bands(body)
    hinge = np.asarray((body.axes > 0).sum(1) == 1)
    for motion_name in MOTIONS:
        motion = make_motion(body, motion_name, 1.0, 5.0)
        poses = pose_body(body, motion.root, motion.rotations)
        for i in range(len(motion)):
            a = in_world(body, poses[i], body.topology.parents, band.first_points)
            b = in_world(body, poses[i], body.topology.children, band.second_points)
            used = hinge[:, None] & np.asarray(band.weights > 0)
            assert np.linalg.norm(a - b, axis=-1)[used].max() < 1e-5, motion_name


def joint_at(sim, name):
    return sim.joints[:, sim.body.topology.centres.index(name)].astype(float)


def test_motions_go_the_human_way():
    """Facing +x: knees bend back, elbows bend forward, bowing goes forward, waving lifts the right hand outside."""
    body = load_body("human")

    def joints(name):
        motion = make_motion(body, name, 2.0, 20.0)
        nowhere = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)
        return simulate(body, motion, nowhere, NO_NOISE, None)

    bow = joints("bow")
    middle = len(bow.time_ns) // 2
    assert (joint_at(bow, "skullbase") - joint_at(bow, "l_hip"))[middle, 0] > 0.25
    assert np.abs(joint_at(bow, "l_talocrural") - joint_at(bow, "l_talocrural")[0]).max() < 0.01
    wave = joints("wave")
    hand, shoulder = joint_at(wave, "r_radiocarpal")[middle], joint_at(wave, "r_shoulder")[middle]
    assert hand[2] > shoulder[2] + 0.1 and hand[1] < shoulder[1] - 0.15
    walk = joints("walk")
    assert 0.5 < joint_at(walk, "vc7")[-1, 0] - joint_at(walk, "vc7")[0, 0] < 3.0
    hip, knee, ankle = (joint_at(walk, f"l_{n}") for n in ("hip", "knee", "talocrural"))
    thigh, shank = (knee - hip)[:, [0, 2]], (ankle - knee)[:, [0, 2]]
    bend = np.unwrap(np.arctan2(shank[:, 0], -shank[:, 1]) - np.arctan2(thigh[:, 0], -thigh[:, 1]))
    assert bend.min() < -0.6 and bend.max() < 0.2  # the shank falls behind the thigh, never before it
    swing = (knee - hip)[:, 0]
    assert swing.max() > 0.1  # the thigh comes forward
    lengths = np.linalg.norm(knee - hip, axis=1)
    assert np.ptp(lengths) < 0.03  # the centres sit beside the hinge by centimetres at most


def test_sequence_is_continuous_and_has_even_steps():
    body = load_body("human")
    parts = [make_motion(body, name, 1.0, 20.0) for name in ("stand", "walk", "bow")]
    motion = sequence(*parts)
    assert len(motion) == 60
    np.testing.assert_allclose(np.diff(motion.time), 0.05, atol=1e-9)
    assert np.linalg.norm(np.diff(motion.root.translation, axis=0), axis=1).max() < 0.15
    assert motion.root.translation[-1, 0] > 0.15
    with pytest.raises(ValueError, match="no motion named 'fly'"):
        make_motion(body, "fly")


def test_proportions_keep_joints_together():
    body = load_body("human")
    arms = {"l_upper_arm": 1.1, "r_upper_arm": 1.1}
    other = with_proportions(body, arms, girth=1.05)
    t = body.topology
    parent = in_world(other, other.rest, t.parents, other.parent_anchor.translation[:, None])
    child = in_world(other, other.rest, t.children, other.child_anchor.translation[:, None])
    np.testing.assert_allclose(parent, child, atol=5e-6)
    before, after = segment_lengths(body), segment_lengths(other)
    assert after["upper_arm"] > 1.05 * before["upper_arm"]
    assert after["thigh"] == pytest.approx(before["thigh"], rel=1e-4)
    with pytest.raises(ValueError, match="no limb named"):
        with_proportions(body, {"wing": 2.0})


def frustum_mesh(size, turn, at, sides=256) -> trimesh.Trimesh:
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    ring = lambda a, b, z: np.stack([a * np.cos(angle), b * np.sin(angle), np.full(sides, z)], -1)  # noqa: E731
    vertices = np.concatenate(
        [ring(size[0], size[1], 0), ring(size[2], size[3], size[4]), [[0, 0, 0], [0, 0, size[4]]]]
    )
    i = np.arange(sides)
    j = (i + 1) % sides
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = [(i, j, i + sides), (j, j + sides, i + sides), (j, i, low), (i + sides, j + sides, high)]
    return trimesh.Trimesh(vertices @ turn.T + at, np.concatenate([np.stack(f, -1) for f in faces]), process=False)


def test_render_against_trimesh():
    """Depth within 0.5 mm of a mesh of 256 sides where the surface is not seen edge on; silhouettes agree."""
    body = load_body("human")
    motion = placed(make_motion(body, "wave", 1.5, 4.0), 2.5, 0.1, 3.5)
    poses = pose_body(body, motion.root, motion.rotations)[3]
    camera = Camera(64, 50, 72.7, 68.9, 31.5, 24.5, (0.0, 0.0, 1.2), 0.07)
    depth, cosine = render(body, poses, camera, None)
    parts = zip(np.asarray(body.sizes, float), turn_matrices(poses), np.asarray(poses.translation, float))
    mesh: Any = trimesh.util.concatenate([frustum_mesh(*part) for part in parts])
    rays = camera.rays()
    origins = np.broadcast_to(np.array(camera.position), rays.shape)
    points, index, _ = mesh.ray.intersects_location(origins, rays, multiple_hits=True)
    along = ((points - camera.position) @ camera.rotation)[:, 2]
    oracle = np.full(len(rays), np.inf)
    np.minimum.at(oracle, index, along)
    depth, cosine = depth.ravel(), cosine.ravel()
    assert np.isfinite(oracle).sum() > 200
    assert (np.isfinite(depth) != np.isfinite(oracle)).sum() <= 2
    both = np.isfinite(depth) & np.isfinite(oracle) & (cosine > 0.2)
    assert np.abs(depth[both] - oracle[both]).max() < 5e-4


def test_render_room():
    """The floor, the wall and the box are where they are said to be."""
    body, camera = load_body("arm"), tof_camera()
    away = Poses(body.rest.rotation, body.rest.translation + np.array([-10.0, 0, 0], np.float32))
    depth, cosine = render(body, away, camera, Room())
    points = camera.rays() * depth.reshape(-1, 1) + camera.position
    on_floor, on_wall = np.abs(points[:, 2]) < 1e-9, np.abs(points[:, 0] - 5.0) < 1e-9
    assert on_floor.sum() > 1000 and on_wall.sum() > 1000
    rest = points[~on_floor & ~on_wall]
    box = Room().boxes[0]
    half = np.array(box.size) / 2
    local = (rest - [box.x, box.y, half[2]]) @ Rotation.from_euler("z", box.yaw).as_matrix()
    assert len(rest) > 100 and np.abs(np.abs(local / half).max(1) - 1).max() < 1e-9
    assert (cosine > 0).all() and (cosine <= 1).all()


@pytest.mark.parametrize("distance", [1.0, 2.5, 4.0])
def test_tof_noise_has_the_stated_deviation(distance):
    camera = tof_camera()
    shape = (camera.height, camera.width)
    stretch = np.linalg.norm(camera.rays(), axis=1).reshape(shape)
    noisy = add_noise(distance / stretch, np.ones(shape), camera, TOF_NOISE, np.random.default_rng(0))
    seen = noisy > 0
    assert 1 - seen.mean() == pytest.approx(TOF_NOISE.dropout, abs=0.002)
    error = (noisy / 1000 * stretch - distance)[seen]
    assert error.std() == pytest.approx(0.004 + 0.0015 * distance**2, rel=0.05)
    assert abs(error.mean()) < 3e-4


def test_kinect_noise_is_quantised_by_disparity():
    camera = kinect_camera()
    shape = (camera.height, camera.width)
    noisy = add_noise(np.full(shape, 3.0), np.ones(shape), camera, KINECT_NOISE, np.random.default_rng(0))
    levels = np.unique(noisy[noisy > 0])
    step = 9.0 / KINECT_NOISE.disparity  # metres per disparity step at 3 m
    assert np.median(np.diff(levels)) == pytest.approx(step * 1000, abs=1.5)
    stretch = np.linalg.norm(camera.rays(), axis=1).reshape(shape)
    expected = np.sqrt(np.mean((1.425e-3 * 9 * stretch) ** 2) + step**2 / 12)
    assert (noisy[noisy > 0] / 1000).std() == pytest.approx(expected, rel=0.1)


def test_flying_pixels_and_grazing_and_range():
    camera = tof_camera()
    shape = (camera.height, camera.width)
    depth = np.full(shape, 2.0)
    depth[:, 80:] = 3.0
    noisy = add_noise(depth, np.ones(shape), camera, Noise(flying=0.5), np.random.default_rng(0))
    between = (noisy > 2050) & (noisy < 2950)
    assert between[:, 79:81].mean() == pytest.approx(0.5 / 4 * 0.9, abs=0.05)
    assert not between[:, :79].any() and not between[:, 81:].any()
    grazing = add_noise(depth, np.full(shape, 0.05), camera, Noise(grazing=0.1), np.random.default_rng(0))
    assert (grazing == 0).mean() == pytest.approx(0.5, abs=0.02)
    near = add_noise(depth, np.ones(shape), camera, Noise(max_range=2.5), np.random.default_rng(0))
    assert (near[:, 80:] == 0).all() and (near[:, :80] == 2000).all()


def test_written_twice_is_bit_identical_and_reads_back(tmp_path):
    sim = tiny()
    paths = [
        write_simulation(s, tmp_path / d / "x.mcap")
        for s, d in ((sim, mkdir(tmp_path / "a")), (tiny(), mkdir(tmp_path / "b")))
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    truths = [p.with_name("x.truth.npz") for p in paths]
    assert truths[0].read_bytes() == truths[1].read_bytes()
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["x.mcap", "x.truth.npz"]
    recording = read_log(paths[0], ReadSettings())
    assert recording.fixed_frame == "base" and recording.sensors == ("/depth/image",)
    assert [f.time_ns for f in recording] == sim.time_ns.tolist()
    for frame, image in zip(recording, sim.depth):
        z = image.reshape(-1, 1) / 1000
        expected = (SMALL.rays() * z + SMALL.position)[z[:, 0] > 0.1]
        assert len(frame.points) == len(expected)
        np.testing.assert_allclose(frame.points[np.lexsort(frame.points.T)], expected[np.lexsort(
            expected.astype(np.float32).T)], atol=0.02)  # fmt: skip
        assert np.abs(frame.points.mean(0) - expected.mean(0)).max() < 1e-4
        np.testing.assert_allclose(frame.origins[0], SMALL.position, atol=1e-6)


def mkdir(path):
    path.mkdir()
    return path.name


def test_seed_matters_only_for_noise():
    a, b = tiny(seed=1), tiny(seed=2)
    assert (a.depth != b.depth).any()
    np.testing.assert_array_equal(a.joints, b.joints)
    assert (tiny(seed=1, noise=NO_NOISE).depth == tiny(seed=2, noise=NO_NOISE).depth).all()


def test_truth_layout(tmp_path):
    body = scaled(load_body("human"), 1.74)
    sim = simulate(body, placed(make_motion(body, "stand", 0.2, 10.0), 2.5, 0.0, np.pi), SMALL)
    write_simulation(sim, tmp_path / "y.mcap")
    with np.load(tmp_path / "y.truth.npz", allow_pickle=False) as truth:
        assert truth["time_ns"].dtype == np.int64 and truth["time_ns"].shape == (2,)
        assert truth["joints"].dtype == np.float32 and truth["joints"].shape == (2, len(body.topology.centres), 3)
        assert truth["names"].tolist() == list(body.topology.centres)
        dims = json.loads(str(truth["dims"]))
    assert dims["stature"] == pytest.approx(1.74) and set(dims) == {"stature", *segment_lengths(body)}


@pytest.mark.parametrize("name", ["arm", "dog"])
def test_any_body(tmp_path, name):
    """Nothing knows that it is a person: the body is seen, on its own surface, and the file says no stature."""
    sim = tiny(name, "swing", noise=NO_NOISE, room=None, camera=replace(SMALL, position=(0.0, 0.0, 0.6)))
    assert (sim.depth > 0).sum((1, 2)).min() > 10
    assert np.abs(sim.joints - sim.joints[:1]).max() > 0.01
    write_simulation(sim, tmp_path / "any.mcap")
    with np.load(tmp_path / "any.truth.npz", allow_pickle=False) as truth:
        assert "stature" not in json.loads(str(truth["dims"]))
    tracks = truth_tracks(sim)
    assert tracks.tracked.all() and tracks.joints.shape == sim.joints.shape


def test_packaged_demo():
    """The demo in the package is small, reads, and its truth belongs to it."""
    from importlib import resources

    data = resources.files("voodoo_jax") / "data"
    with resources.as_file(data / "demo.mcap") as log, resources.as_file(data / "demo.truth.npz") as beside:
        assert log.stat().st_size + beside.stat().st_size < 1_500_000
        recording = read_log(log, ReadSettings())
        with np.load(beside, allow_pickle=False) as truth:
            assert truth["time_ns"].tolist() == [f.time_ns for f in recording]
            assert json.loads(str(truth["dims"]))["stature"] == pytest.approx(1.74)
