"""Somebody in front of a simulated camera, ready to be tracked, and how far tracked segments are off."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.records.segment import Segment
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import motion_of_turns, placed
from voodoo_jax.simulate.recording import Simulation, simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.solve.scan import options_from
from voodoo_jax.trackers.icp.runner import Runner


def in_front(
    path: Path, body: Body, turns: dict[str, np.ndarray], count: int = 30, nearer: float = 0.0
) -> tuple[Simulation, Runner]:
    """A second, 3.2 m away and in the end `nearer` by so many metres, with some joints turned (rotation vectors [frame,
    3], radians): what is so, and the runner that tracks it. Writes a log at `path`."""
    moved = motion_of_turns(body, np.arange(count) / 30, turns)
    gone = np.outer(np.linspace(0, nearer, count), [1.0, 0, 0]).astype(np.float32)
    moved = replace(moved, root=Poses(moved.root.rotation, moved.root.translation + gone))
    sim = simulate(body, placed(moved, 3.2, 0.0, np.pi), tof_camera(1.2, 0.0))
    recording, settings = read_log(write_simulation(sim, path)), Settings()
    scene, people = find_body(recording, recording.up, body, settings)
    return sim, Runner(body, options_from(settings.solve, settings.track, settings.features), people, scene, settings)


def error(sim: Simulation, found: Segment) -> np.ndarray:
    """Mean joint error of each frame, metres."""
    at = [np.asarray(joint_centres(sim.body, Poses(*p))) for p in zip(found.rotation, found.translation)]
    return np.linalg.norm(at - sim.joints, axis=-1).mean(1)
