"""Who does not stand at first is started where they do."""

from dataclasses import replace

import numpy as np
import pytest

from voodoo_jax.config.options import Settings
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import Motion, make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.front import track


@pytest.fixture(scope="module")
def rising(tmp_path_factory):
    """A person who is bent over when the recording begins, and stands up."""
    body = scaled(human(), 1.8)
    motion = placed(make_motion(body, "bow", 3.0, 15.0), 3.2, 0.0, np.radians(150))
    bent = len(motion) // 2
    motion = Motion(motion.time[bent:], motion.root[bent:], motion.rotations[bent:])
    sim = simulate(body, motion, tof_camera(1.0, 0.07))
    return sim, read_log(write_simulation(sim, tmp_path_factory.mktemp("rising") / "rising.mcap"))


def test_who_does_not_stand_at_first_is_followed_back_from_where_they_do(rising):
    sim, recording = rising
    tracks = track(human(), recording, Settings())
    assert abs(float(tracks.body.scale) - 1.8) < 0.03 and tracks.tracked.all()
    assert np.linalg.norm(tracks.joints - sim.joints, axis=-1).mean() < 0.03


def test_without_a_look_ahead_the_first_frames_settle_the_size(rising):
    _, recording = rising
    settings = replace(Settings(), track=replace(Settings().track, skip=("looks_ahead",)))
    # bent over, the person is measured too small, or is taken for a taller one who sits
    assert abs(float(track(human(), recording, settings).body.scale) - 1.8) > 0.05
