"""Who is cut off below, over a floor that nobody sees, and sits or stands lower than it seems."""

from dataclasses import replace

import numpy as np
import pytest

from voodoo_jax.config.options import Settings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import motion_of_turns, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import tof_camera
from voodoo_jax.trackers.front import track

TALL, LOWER = 1.75, 0.3  # metres: a person's stature, and how much lower than a standing one's their head is


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """An upper body 1.3 m from a camera that sees neither legs nor floor; the arms sway."""
    body, time = scaled(human(), TALL), np.arange(20) / 15
    sway = 0.2 * np.sin(4 * time)[:, None] * np.array([0.0, 1.0, 0.0])
    moved = placed(motion_of_turns(body, time, {"l_shoulder": sway, "r_shoulder": -sway}), 1.3, 0.0, np.pi)
    lower = np.asarray(moved.root.translation) - np.array([0, 0, LOWER], np.float32)
    moved = replace(moved, root=Poses(moved.root.rotation, lower))
    sim = simulate(body, moved, tof_camera(1.2, 0.0), room=None)
    return sim, write_simulation(sim, tmp_path_factory.mktemp("cut") / "log.mcap")


def test_head_and_shoulders_tell_the_size(log):
    sim, path = log
    tracks = track(human(), read_log(path))
    assert tracks.tracked.all() and float(tracks.body.scale) == pytest.approx(TALL, abs=0.1)
    at = [tracks.body.topology.centres.index(name) for name in ("skullbase", "vc7", "l_shoulder", "r_shoulder")]
    known = [sim.body.topology.centres.index(tracks.body.topology.centres[k]) for k in at]
    assert np.linalg.norm(tracks.joints[:, at] - sim.joints[:, known], axis=-1).mean() < 0.04


def test_without_it_the_height_of_the_head_is_the_size(log):
    settings = Settings()
    settings = replace(settings, track=replace(settings.track, skip=("cut_off_size",)))
    assert float(track(human(), read_log(log[1]), settings).body.scale) < TALL - 0.2


def test_a_size_that_is_given_stays(log):
    settings = Settings()
    settings = replace(settings, start=replace(settings.start, scale=1.6))
    assert float(track(human(), read_log(log[1]), settings).body.scale) == pytest.approx(1.6)
