"""Results that wait: what is farther ahead than the lag changes nothing; a long lag is the pass back from the end."""

from dataclasses import fields, replace
from importlib.resources import files

import numpy as np
import pytest

import voodoo_jax as vj
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body_file import human
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.icp.live import LiveTracker
from voodoo_jax.trackers.of_points import track_person

LAG = 0.3
ONLINE = vj.online(Settings())


@pytest.fixture(scope="module")
def demo():
    """Floor and walls, and the person in the demo's first frames."""
    source = open_log(str(files("voodoo_jax") / "data" / "demo.mcap"))
    frames = [frame for frame, _ in zip(source.frames(), range(60))]
    return find_body(frames, source.up, human(), ONLINE)


def tracks_of(demo, settings: Settings, frames: int = 60) -> Tracks:
    scene, people = demo
    return track_person(Task(human(), LogInfo("demo", "base"), settings), scene, people[:frames])


def equal(some: Tracks, other: Tracks, frames: int) -> bool:
    names = "status", "rotation", "translation", "passes_apart", "limb_weight"
    return all(np.array_equal(*(t.rows()[n][:frames] for t in (some, other)), equal_nan=True) for n in names)


def test_what_is_farther_ahead_than_the_lag_changes_nothing(demo):
    lagged, plain = tracks_of(demo, vj.online(Settings(), LAG)), tracks_of(demo, ONLINE)
    time = lagged.time_ns / 1e9
    for cut in (33, 47):
        frames = int(np.sum(time + LAG < time[cut - 1]))
        assert frames > 20 and equal(tracks_of(demo, vj.online(Settings(), LAG), cut), lagged, frames)
    assert np.isfinite(lagged.rows()["passes_apart"][:-1]).all() and np.isnan(plain.rows()["passes_apart"]).all()
    assert 1e-4 < np.linalg.norm(lagged.joints - plain.joints, axis=-1).mean() < 0.02
    skipped = replace(vj.online(Settings(), LAG), track=replace(Settings().track, skip=("fixed_lag",)))
    assert equal(tracks_of(demo, skipped), plain, 60)


def test_a_long_lag_is_the_pass_back_from_the_end(demo):
    """Offline of all that looks ahead: the two passes alone, from the same start."""
    from voodoo_jax.trackers.icp.pipeline import stages

    others = [s.name for s in stages() if s.looks_ahead and s.name != "forward_backward"]
    offline = replace(Settings(), track=replace(Settings().track, skip=tuple(others)))
    assert equal(tracks_of(demo, vj.online(Settings(), 1e6)), tracks_of(demo, offline), 60)


def test_where_it_goes(demo, tmp_path, capsys):
    assert vj.online(Settings(), 0.0) == ONLINE and {f.name for f in fields(Settings)} >= {"online_lag"}
    log = str(files("voodoo_jax") / "data" / "demo.mcap")
    assert main(["replay", log, "--out", str(tmp_path), "--online.lag", "0.5"]) == 2
    assert "needs --online" in capsys.readouterr().err
    scene, people = demo
    with pytest.raises(SettingsError, match="online_lag"):
        LiveTracker(human(), vj.online(Settings(), LAG), people[:1], scene)
