"""Tuning by gradients through whole recordings: where a second camera stands, from points alone."""

import jax.numpy as jnp
import numpy as np

import voodoo_jax as vj
from tests.support.helpers import scipy_rotation, seen_points, two_limbs
from tests.support.segments import blank_tracks
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.parameters import middles
from voodoo_jax.fitting.seen import Seen
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import Poses, quat_exp
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status
from voodoo_jax.simulate.motion import pose_body

CAMERAS = np.array([[2.0, 0.4, 0.5], [-0.5, 1.8, 0.9]], np.float32)
FRAMES, POINTS = 8, 64
SHIFT = np.array([0.02, -0.015, 0.015])  # 3 cm
TURN = np.radians([1.2, -1.0, 1.2])  # 2 degrees


def seen_by_two(rng: np.random.Generator) -> Seen:
    """Two limbs that turn and bend before two cameras, of which the second one is elsewhere than it is said to be."""
    body, time = two_limbs((0.03, 0.0)), np.arange(FRAMES) * 0.2
    turn = np.stack([0.5 * np.sin(time), 0.8 * time, 0.2 * time], -1)
    root = Poses(quat_exp(jnp.asarray(turn, jnp.float32)), jnp.asarray(turn * [0.1, 0.2, 0.1], jnp.float32))
    poses = pose_body(body, root, np.stack([0.9 * np.cos(time), 0 * time, 0 * time], -1)[:, None])
    back = scipy_rotation(np.asarray(quat_exp(jnp.asarray(-TURN, jnp.float32))))
    people = []
    for i in range(FRAMES):
        there = CAMERAS[0], CAMERAS[1] + SHIFT
        first, second = (seen_points(rng, body, poses[i], camera, 2 * POINTS) for camera in there)
        second = back.apply(second - there[1]) + CAMERAS[1]
        sensor = np.repeat(np.arange(2), 2 * POINTS).astype(np.int32)
        people.append(
            BodyObservation(
                10**18 + i * 200_000_000, np.concatenate([first, second]).astype(np.float32), sensor, CAMERAS
            )
        )
    known = {"rotation": np.asarray(poses.rotation), "translation": np.asarray(poses.translation)}
    tracks = blank_tracks(body, FRAMES, status=np.full(FRAMES, Status.TRACKED, np.int8), **known)
    return Seen(tracks, people, Scene(Plane(np.array([0, 0, 1], np.float32), 0.0), (), False))


def test_a_camera_is_a_parameter_like_others(rng):
    """From where it stands 3 cm and 2 degrees off, which moves what it sees by 7 cm."""
    problem = vj.problem(two_limbs((0.03, 0.0)), seen_by_two(rng), Settings(), points=POINTS)
    names = [f"sensors.1.{name}{k}" for name in ("", "turn_") for k in "xyz"]
    found = vj.tune(problem, names, loss=vj.loss.points, steps=12, pull=0.0)
    middle = np.asarray(middles(problem.frames.points))[1]
    shift, turn = np.array([found.parameters[name] for name in names]).reshape(2, 3)
    seen = scipy_rotation(np.asarray(quat_exp(jnp.asarray(TURN, jnp.float32)))).apply(middle - CAMERAS[1])
    wanted = CAMERAS[1] + SHIFT + seen - middle
    print(found.curve, shift, wanted, np.degrees(turn), found.finished)
    assert np.linalg.norm(wanted) > 0.05
    assert np.linalg.norm(shift - wanted) < 0.005
    assert np.linalg.norm(turn - TURN) < np.radians(1.0)
    assert found.after < 0.03 * found.before
