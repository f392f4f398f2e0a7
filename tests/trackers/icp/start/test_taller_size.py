"""Who bends or walks is taller than they look, but nobody is for a jump or a raised hand."""

import numpy as np
import pytest

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import Motion, make_motion, motion_of_turns, placed, sequence
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.front import track


def test_who_jumps_is_not_taller(tmp_path):
    """Somebody who is bent at first, stands up, and jumps meanwhile or not."""
    body, bent, sizes = scaled(human(), 1.8), 22, []
    whole = sequence(make_motion(body, "bow", 3.0, 15.0), make_motion(body, "stand", 2.0, 15.0))
    motion = placed(whole, 3.2, 0.0, np.radians(150))
    for high in (0.0, 0.2):
        lift = np.zeros((len(motion) - bent, 3), np.float32)
        lift[20:36, 2] = high
        root = Poses(motion.root.rotation[bent:], motion.root.translation[bent:] + lift)
        sim = simulate(body, Motion(motion.time[bent:], root, motion.rotations[bent:]), tof_camera(1.0, 0.07))
        sizes.append(track(human(), read_log(write_simulation(sim, tmp_path / "jump.mcap"))).body.scale)
    # a taller person who sits may explain the first frames better than a bent one of measured size, and then no frame
    # on both feet is asked; by the jump itself it would be 20 cm
    assert abs(float(sizes[1] - sizes[0])) < 0.11


def test_a_hand_above_the_head_makes_nobody_taller(tmp_path):
    """Far away, where noise leaves a doubt and later frames are asked; in some of them a hand is what is highest."""
    body, time = scaled(human(), 1.7), np.arange(60) / 30
    up = np.interp(time, [1.0, 1.3, 1.7, 2.0], [0.0, 1.0, 1.0, 0.0])[:, None] * np.array([3.3, 0.0, 0.0])
    moved = placed(motion_of_turns(body, time, {"l_shoulder": up, "r_shoulder": -up}), 4.6, 0.0, np.pi)
    recording = read_log(write_simulation(simulate(body, moved, tof_camera(1.2, 0.0)), tmp_path / "up.mcap"))
    tracks = track(human(), recording)
    assert tracks.tracked.all() and float(tracks.body.scale) == pytest.approx(1.7, abs=0.06)
