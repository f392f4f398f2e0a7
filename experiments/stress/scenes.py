"""Simulated scenes that are hard to track, each with a time-of-flight camera and nothing given."""

from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from experiments.demo.make_demo import demo_body
from experiments.judged import Recorded
from experiments.stress.motions import (
    CROSSED,
    CROUCHED,
    DRAWN,
    HIGH,
    IN_THE_AIR,
    KICK_BACK,
    KICKED,
    KNEES_BENT,
    LEG_ASIDE,
    PUNCHED,
    RAISED,
    RATE,
    RELAXED,
    SITTING,
    SPREAD,
    STOOPED,
    SWORD_DOWN,
    SWORD_UP,
    Pose,
    posed,
    running,
    turning,
    with_neck,
)
from voodoo_jax.model.body import Body, joint_centres, scaled, segment_lengths
from voodoo_jax.records.recording import Frame
from voodoo_jax.simulate.motion import Motion, make_motion, placed, pose_body, sequence
from voodoo_jax.simulate.recording import FIXED_FRAME, render
from voodoo_jax.simulate.room import Box, Room
from voodoo_jax.simulate.sensor import TOF_NOISE, Camera, Noise, add_noise, tof_camera

START_NS = 1_700_000_000_000_000_000
ROOM = Room(boxes=(Box(2.9, 1.35, (0.5, 0.45, 0.75), 0.3),))


@dataclass(frozen=True)
class Scene:
    """A person who moves, and what else there is. The motion is in the fixed frame."""

    body: Body
    motion: Motion
    camera: Camera | None = None
    room: Room = ROOM
    other: tuple[Body, Motion] | None = None  # a second person, who is not to be tracked
    absent: float = 0.0  # seconds before the motion begins, the person not there
    tilt: float = 0.0  # error of the camera's known pitch, radians
    noise: Noise = TOF_NOISE
    every: int = 1  # frames of the motion for one of the sensor


class Scanner(Camera):
    """A laser scanner with rows from 15 degrees above to 15 below, over 120 degrees in steps of 0.2."""

    def rays(self) -> np.ndarray:
        rise, level = np.radians(np.linspace(15, -15, self.height)), np.radians(np.linspace(60, -60, self.width))
        e, a = np.meshgrid(rise, level, indexing="ij")
        return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).reshape(-1, 3)


def shoot(name: str, scene: Scene, frames: int = 0) -> Recorded:
    """What the camera records of a scene (the first `frames` frames; 0: all), and the truth."""
    camera = scene.camera or tof_camera()
    wait, count = round(scene.absent * RATE), len(scene.motion)
    poses = pose_body(scene.body, scene.motion.root, scene.motion.rotations)
    nobody = eqx.tree_at(lambda b: b.presence, scene.body, jnp.zeros(scene.body.limb_count))
    joints = np.asarray(jax.vmap(joint_centres, (None, 0))(scene.body, poses), float)
    joints = np.concatenate([np.full((wait, *joints.shape[1:]), np.nan), joints])
    others = pose_body(scene.other[0], scene.other[1].root, scene.other[1].rotations) if scene.other else None
    # about the camera, about the axis to its right
    tilt = Rotation.from_rotvec(scene.tilt * camera.rotation[:, 0])
    position = np.array(camera.position)
    found = []
    for i in range(0, min(frames or count + wait, count + wait), scene.every):
        body = scene.body if i >= wait else nobody
        depth, cosine = render(body, poses[max(i - wait, 0)], camera, scene.room)
        if scene.other and others is not None:
            more, slant = render(scene.other[0], others[min(i, len(scene.other[1]) - 1)], camera, None)
            depth, cosine = np.minimum(depth, more), np.where(more < depth, slant, cosine)
        z = add_noise(depth, cosine, camera, scene.noise, np.random.default_rng([7, i])).ravel() / 1000
        points = position + tilt.apply(camera.rays()[z > 0] * z[z > 0, None])
        stamp = START_NS + round(i / RATE * 1e9)
        origins = np.asarray(position, np.float32)[None]
        found.append(Frame(stamp, points.astype(np.float32), np.zeros(len(points), np.int32), origins))
    joints = joints[: len(found) * scene.every : scene.every]
    stamps = np.array([f.time_ns for f in found], np.int64)
    dims = segment_lengths(scene.body) | {"stature": float(scene.body.scale)}
    up, there = np.array([0, 0, 1], np.float32), _in_view(joints, camera)
    joints = position + tilt.apply((joints - position).reshape(-1, 3)).reshape(joints.shape)
    return Recorded(name, FIXED_FRAME, up, found, stamps, scene.body.topology.centres, joints, there, dims)


def _in_view(joints: np.ndarray, camera: Camera) -> np.ndarray:
    """[time] Whether all joints are in the picture; NaN is not. A scanner sees all around."""
    if isinstance(camera, Scanner):
        return np.asarray(np.isfinite(joints).all((1, 2)))
    seen = (joints - camera.position) @ camera.rotation
    u, v = (seen[..., :2] / seen[..., 2:]).transpose(2, 0, 1)
    u, v = camera.cx + camera.fx * u, camera.cy + camera.fy * v
    return ((u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)).all(1)


def _bow_wave(body: Body) -> Motion:
    return sequence(*(make_motion(body, n, s, RATE) for n, s in (("stand", 0.7), ("wave", 2.0), ("bow", 1.8))))


def _facing(motion: Motion, x: float = 3.0) -> Motion:
    """Before the camera, and not quite towards it."""
    return placed(motion, x, 0.0, np.pi + 0.2)


def _comes_in(body: Body) -> Motion:
    walk = make_motion(body, "walk", 3.3, RATE)
    return placed(
        sequence(walk, turning(body, -np.pi / 2, 1.0), make_motion(body, "wave", 2.0, RATE)), 3.4, 3.4, -np.pi / 2
    )


def _goes_and_comes(body: Body) -> Motion:
    aside, stand, walk = turning(body, -np.pi / 2, 0.8), make_motion(body, "stand", 1.0), make_motion(body, "walk", 4.5)
    return placed(sequence(stand, aside, walk, turning(body, np.pi, 0.8), walk, aside, stand), 3.4, 0.0, np.pi)


# key poses: seconds to get there, pose
KICKS = ((0.4, KICK_BACK), (0.38, KICKED), (0.2, KICKED), (0.45, RELAXED), (0.3, RELAXED))
PUNCHES = ((0.11, PUNCHED), (0.15, PUNCHED), (0.25, DRAWN), (0.2, DRAWN))
SITS = ((0.7, STOOPED), (0.6, SITTING), (1.2, SITTING), (0.6, STOOPED), (0.7, RELAXED), (0.5, RELAXED))
KEEPS_SITTING = ((0.0, SITTING), (1.0, SITTING), (0.5, SITTING | RAISED), (1.0, SITTING | RAISED), (0.5, SITTING))
CROSSES = ((0.8, CROSSED), (1.2, CROSSED), (0.8, RELAXED), (0.4, RELAXED))
CROUCHES = ((0.9, CROUCHED), (1.0, CROUCHED), (0.9, RELAXED), (0.5, RELAXED))
SLASHES = ((0.35, SWORD_UP), (0.1, SWORD_UP), (0.2, SWORD_DOWN), (0.25, SWORD_DOWN), (0.4, RELAXED))
ROUND = {"lean": (0.0, 0.0, 2 * np.pi)}
DANCES = (
    (0.4, SPREAD), (0.9, SPREAD | ROUND), (0.3, LEG_ASIDE | ROUND), (0.3, HIGH | ROUND), (0.3, KNEES_BENT | ROUND),
    (0.3, SPREAD | ROUND), (0.9, SPREAD), (0.4, RELAXED), (0.2, RELAXED),
)  # fmt: skip
JUMPS = ((0.35, KNEES_BENT), (0.18, HIGH), (0.2, IN_THE_AIR), (0.2, HIGH), (0.2, KNEES_BENT), (0.4, RELAXED))
# seconds to get there, metres per second
DASH = ((0.0, 0.0), (0.5, 0.0), (0.4, 8.0), (0.1, 8.0), (0.4, 0.0), (0.4, 0.0))
STANDS = ((0.0, RELAXED), (0.7, RELAXED))
CUPBOARD = Room(boxes=(Box(4.2, 0.9, (0.5, 0.8, 1.85)), Box(2.9, 1.75, (0.5, 0.45, 0.75), 0.3)))
# all around: a scanner of few rows sees far
HALL = Room(True, 7.0, (Box(3, 3.6, (8, 0.1, 2.6)), Box(3, -3.6, (8, 0.1, 2.6)), Box(5.5, 2.2, (0.5, 0.45, 0.75), 0.3)))
CHAIR = Room(boxes=(Box(3.47, 0.06, (0.46, 0.46, 0.38), 0.2),))


def scenes() -> dict[str, Callable[[], Scene]]:
    """All scenes by name; each is made when it is asked for."""
    body = with_neck(demo_body())
    tall = scaled(body, 1.86)

    def seen(x: float, height: float, pitch: float, tilt: float = 0.0) -> Callable[[], Scene]:
        return lambda: Scene(body, _facing(_bow_wave(body), x), tof_camera(height, pitch), tilt=tilt)

    def keys(*more: tuple[float, Pose], ground: bool = False, room: Room = ROOM) -> Callable[[], Scene]:
        return lambda: Scene(body, _facing(posed(body, [*STANDS, *more], ground)), room=room)

    def followed() -> Scene:
        motion = sequence(_bow_wave(body), make_motion(body, "stand", 1.0, RATE))
        behind = placed(make_motion(tall, "walk", 6.5, RATE), 4.5, 3.2, -np.pi / 2)
        return Scene(body, _facing(motion, 2.9), room=Room(wall=5.6, boxes=()), other=(tall, behind))

    def turns_round() -> Scene:
        stand = make_motion(body, "stand", 0.8, RATE)
        return Scene(body, _facing(sequence(stand, turning(body, 2 * np.pi, 3.0), stand)))

    def dashes(x: float, y: float, yaw: float) -> Callable[[], Scene]:
        return lambda: Scene(body, placed(running(body, [*DASH]), x, y, yaw), room=Room(wall=9.0, boxes=()))

    def scanned(rows: int) -> Callable[[], Scene]:
        motion = placed(sequence(_bow_wave(body), make_motion(body, "walk", 3.0, RATE)), 4.8, 0.3, np.pi + 0.3)
        noise = Noise(constant=0.02, quadratic=0.0, flying=0.1, dropout=0.02, grazing=0.05, max_range=30.0)
        return lambda: Scene(body, motion, Scanner(600, rows, 1, 1, 0, 0, (0, 0, 1.2)), HALL, noise=noise, every=3)

    return {
        "standing, wave, bow": seen(3.0, 1.2, 0.07),
        "enters late from the side": lambda: Scene(body, _comes_in(body), absent=1.0),
        "enters late, a cupboard is there": lambda: Scene(body, _comes_in(body), room=CUPBOARD, absent=1.0),
        "leaves, a cupboard stays, comes back": lambda: Scene(body, _goes_and_comes(body), room=CUPBOARD),
        "leaves and comes back": lambda: Scene(body, _goes_and_comes(body)),
        "second person walks behind": followed,
        "camera pitched 10 degrees more, from 1.6 m": seen(3.5, 1.6, 0.245),
        "camera pitched 10 degrees more, head out of view": seen(3.2, 1.2, 0.245),
        "camera's known pitch 10 degrees wrong": seen(3.2, 1.2, 0.07, np.radians(10)),
        "camera at 0.5 m": seen(3.2, 0.5, -0.15),
        "camera at 2.2 m": seen(3.2, 2.2, 0.36),
        "sits down, stands up": keys(*SITS, ground=True, room=CHAIR),
        "sits from the beginning": lambda: Scene(body, _facing(posed(body, [*KEEPS_SITTING], True), 3.4), room=CHAIR),
        "arms crossed": keys(*CROSSES),
        "turns round once": turns_round,
        "kicks": keys(*KICKS, *KICKS),
        "punches": keys((0.5, DRAWN), *PUNCHES, *PUNCHES, *PUNCHES),
        "crouches": keys(*CROUCHES, ground=True),
        "slashes": keys(*SLASHES, *SLASHES, ground=True),
        "dances": keys(*DANCES, ground=True),
        "jumps": keys(*JUMPS, *JUMPS, ground=True),
        "laser scanner of 16 rows, 10 Hz": scanned(16),
        "laser scanner of 32 rows, 10 Hz": scanned(32),
        "dashes away at 8 m/s": dashes(2.8, -0.5, 0.15),
        "dashes here at 8 m/s": dashes(6.8, 0.6, np.pi + 0.1),
        "dashes across at 8 m/s": dashes(6.0, -2.1, np.pi / 2),
    }
