"""Dogs that stand, trot by, turn and come up, simulated, tracked and compared."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from voodoo_jax.geometry.rigid import Poses, compose, quat_exp
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.model.body_file import load_body
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import Motion, grounded, motion_of_turns
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.room import Box, Room
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.front import track

RATE, SECONDS = 30, 3.0
SIZES = (0.4, 0.5, 0.6, 0.7, 0.75, 0.85)  # height of the withers, metres; the body file says 0.6
EFFORT = {"stands": 0.15, "trots by": 1.0, "turns": 0.8, "comes up": 1.0}  # how far legs swing
BOX = (0.5, 0.45, 0.75)


@dataclass(frozen=True)
class Take:
    """What a dog does, and which one."""

    what: str
    seed: int


@dataclass(frozen=True)
class Found:
    """How it was tracked."""

    error_cm: float  # mean over joints and frames; without an answer 1 m
    within: float  # 10 cm, percent
    tracked: float  # percent of the frames
    withers_cm: float


def steps(body: Body, effort: float) -> Motion:
    """A trot on the spot, with head and tail moving."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    vector = lambda x, y, z: np.stack(np.broadcast_arrays(x, y, z, time)[:3], -1)  # noqa: E731
    phase, turns = 2 * np.pi * 1.6 * time, {}
    for side, offset in (("l", 0.0), ("r", np.pi)):
        front, rear = phase + offset, phase + offset + np.pi
        turns[f"{side}_shoulder"] = vector(0, -effort * 0.45 * np.sin(front), 0)
        turns[f"{side}_elbow"] = vector(0, effort * 0.5 * np.maximum(np.cos(front), 0) ** 2, 0)
        turns[f"{side}_hip"] = vector(0, -effort * 0.45 * np.sin(rear), 0)
        turns[f"{side}_stifle"] = vector(0, -effort * 0.5 * np.maximum(np.cos(rear), 0) ** 2, 0)
    turns["neck"] = vector(0.25 * np.sin(1.3 * time), 0.3 * np.sin(1.7 * time + 1), 0.4 * np.sin(0.9 * time))
    turns["skull"] = vector(0, 0.3 * np.sin(2.1 * time), 0.2 * np.sin(1.1 * time))
    turns["tail"] = vector(0, 0.3, 0.6 * np.sin(9 * time))
    return grounded(body, motion_of_turns(body, time, turns))


def moved(motion: Motion, what: str, rng: np.random.Generator) -> Motion:
    """The motion along its way through the room."""
    time, near = motion.time, rng.uniform(2.3, 3.0)
    still = np.zeros_like(time)
    if what == "trots by":
        x, y, yaw = near + still, time - SECONDS / 2, np.pi / 2 + still
    elif what == "comes up":
        x, y, yaw = 4.5 - 0.7 * time, 0.2 + still, np.pi + still
    elif what == "turns":
        yaw = np.pi / 2 + 1.2 * time
        x, y = near + 0.5 - 0.6 * np.cos(yaw), -0.6 * np.sin(yaw)
    else:
        x, y, yaw = near + still, still, rng.uniform(0, 2 * np.pi) + still
    turn = quat_exp(jnp.asarray(np.stack([still, still, yaw], -1), jnp.float32))
    place = Poses(turn, jnp.asarray(np.stack([x, y, still], -1), jnp.float32))
    return replace(motion, root=compose(place, motion.root))


def work(take: Take) -> Found:
    """Simulates, tracks and compares."""
    dog, rng = scaled(load_body("dog"), SIZES[take.seed % len(SIZES)]), np.random.default_rng(take.seed)
    motion = moved(steps(dog, EFFORT[take.what]), take.what, rng)
    room = Room(boxes=(Box(4.2, 2.3 if take.what == "trots by" else 1.9, BOX, 0.3),))
    sim = simulate(dog, motion, tof_camera(1.0, 0.12), room=room, seed=take.seed)
    with tempfile.TemporaryDirectory() as folder:
        tracks = track(load_body("dog"), read_log(write_simulation(sim, Path(folder) / "dog.mcap")))
    frames = np.searchsorted(sim.time_ns, tracks.time_ns)
    error = np.linalg.norm(tracks.joints - sim.joints[frames], axis=-1)
    error = np.where(np.isfinite(error), error, 1.0)
    withers = 100 * abs(float(tracks.body.scale) - float(dog.scale))
    return Found(
        100 * float(error.mean()), 100 * float((error < 0.1).mean()), 100 * float(tracks.tracked.mean()), withers
    )
