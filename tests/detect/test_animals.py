"""Bodies that are no people: told from furniture though nobody says how large they are."""

import numpy as np
import pytest

from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import load_body
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.room import Box, Room
from voodoo_jax.simulate.sensor import tof_camera

BOX = Box(4.2, 1.9, (0.5, 0.45, 0.75), 0.3)  # as high as a usual dog


@pytest.mark.parametrize("withers", [0.4, 0.6, 0.9])
@pytest.mark.parametrize("yaw", [90, 250])
def test_a_dog_is_told_from_a_box(tmp_path, withers, yaw):
    """Nobody says how tall it is."""
    dog = scaled(load_body("dog"), withers)
    motion = placed(make_motion(dog, "stand", 0.5, 10.0), 2.7, 0.0, np.radians(yaw))
    sim = simulate(dog, motion, tof_camera(1.0, 0.12), room=Room(boxes=(BOX,)))
    recording = read_log(write_simulation(sim, tmp_path / "dog.mcap"))
    people = find_body(recording, recording.up, load_body("dog"), Settings())[1]
    for frame, joints in zip(people, sim.joints):
        middle = np.median(joints[:, :2], 0)
        assert len(frame.points) > 200
        assert np.linalg.norm(frame.points[:, :2] - middle, axis=1).max() < 1.3 * withers + 0.2
