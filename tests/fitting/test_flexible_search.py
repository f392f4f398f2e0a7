"""The search for settings of the flexible tracker: what is free, how numbers change, when settings are better."""

from dataclasses import replace

import numpy as np
import pytest

import voodoo_jax as vj
from tests.support.segments import blank_tracks
from voodoo_jax.cli.commands import TuneCommand
from voodoo_jax.cli.tune import run_tune
from voodoo_jax.config.options import FlexibleSettings, Settings
from voodoo_jax.config.toml import read_settings
from voodoo_jax.config.tune_options import GROUPS, SHARES, TuneSettings
from voodoo_jax.fitting import flexible_search
from voodoo_jax.fitting.flexible_search import changed, free_names, tune, verdict
from voodoo_jax.fitting.frames import Truth
from voodoo_jax.fitting.gauss_newton import FitError
from voodoo_jax.fitting.judge import Judged, compared
from voodoo_jax.records.tracks import Status
from voodoo_jax.trackers.base import LogInfo
from voodoo_jax.trackers.flexible.tracker import numbers, shape_of

RUNS = 16


def test_what_is_free_needs_no_new_program_and_what_is_off_stays_so():
    s = FlexibleSettings()
    every = free_names(tuple(GROUPS), s)
    rng = np.random.default_rng(0)
    other = changed(s, every, rng.normal(0, 0.5, len(every)))
    assert shape_of(other) == shape_of(s)
    before, after = numbers(s), numbers(other)
    assert not np.allclose(before.weighing.points, after.weighing.points)
    assert all(getattr(other, name) <= 1 for name in SHARES)
    np.testing.assert_allclose(np.divide(other.depth_noise, s.depth_noise), other.depth_noise[0] / s.depth_noise[0])
    assert changed(s, every, np.zeros(len(every))) == s
    paper = vj.preset("hecht2009").flexible
    assert "points_weight" not in free_names(("weights",), paper) and "edge_weight" in free_names(("weights",), paper)
    with pytest.raises(FitError, match="nothing is free"):
        free_names(("points_weight",), paper)
    with pytest.raises(FitError, match="there are noise, weights"):
        free_names(("particles",), s)


def judged(before: float, after: float, noise: float, lost: int = 0) -> Judged:
    rng = np.random.default_rng(1)
    runs = [value * np.exp(noise * rng.standard_normal(RUNS)) for value in (before, after)]
    return Judged("log", 0, np.ones(RUNS, bool), runs[0], runs[1], runs[0], runs[1], lost)


def test_settings_are_better_only_beyond_noise_and_without_losses():
    better, why = verdict(compared([judged(0.05, 0.04, 0.05)], True), 0)
    assert better and "5.03 cm before and 3.97 cm after" in why
    assert not verdict(compared([judged(0.05, 0.049, 0.3)], True), 0)[0]
    assert "worse" in verdict(compared([judged(0.04, 0.05, 0.05)], True), 0)[1]
    one_half_one_twice = compared([judged(0.04, 0.01, 0.02), judged(0.04, 0.08, 0.02)], True)
    assert one_half_one_twice.change < -one_half_one_twice.least and not verdict(one_half_one_twice, 0)[0]
    assert "2 more frames are lost" in verdict(compared([judged(0.05, 0.04, 0.05)], True), 2)[1]


TIMES = 1_000_000_000 + np.arange(64) * 66_666_667
SOURCE = LogInfo("log", "map", np.array([0, 0, 1], np.float32), 1, set(), False, tuple)
BEST = {"edge_weight": 6.0, "base_noise": 0.01}


def follow(body, seen, settings, path, fixed_frame):
    """Stands for the tracker: its error is least at BEST, and a little of it is the seed's."""
    s = settings.flexible
    off = np.log([getattr(s, name) / value for name, value in BEST.items()])
    noise = 0.001 * np.random.default_rng(s.seed).standard_normal(len(TIMES))
    error = np.zeros((len(TIMES), 1, 3))
    error[:, 0, 0] = 0.03 + 0.04 * np.sum(off**2) + noise
    centres = len(body.topology.centres)
    joints = np.broadcast_to(error, (len(TIMES), centres, 3)).astype(np.float32)
    tracks = blank_tracks(body, len(TIMES), joints=joints, status=np.full(len(TIMES), Status.TRACKED, np.int8))
    return replace(tracks, source=path, time_ns=TIMES)


@pytest.fixture
def fake(monkeypatch):
    pytest.importorskip("cma")
    monkeypatch.setattr(flexible_search, "observed_log", lambda body, log, *_: (replace(SOURCE, path=str(log)), None))
    monkeypatch.setattr(flexible_search, "follow", follow)


def truth() -> Truth:
    names = vj.human().topology.centres
    return Truth(TIMES, tuple(names), np.zeros((len(TIMES), len(names), 3)))


def test_the_search_finds_the_best_and_others_judge(fake):
    options = TuneSettings(free=tuple(BEST), evaluations=120, seeds=1, judging_seeds=2)
    logs, settings = ["a.mcap", "b.mcap", "c.mcap"], vj.preset("flexible")
    found = tune(vj.human(), logs, [truth()] * 3, settings, options)
    assert found.better and found.chosen_on == ("a", "c") and found.judged_on == ("b",)
    for name, value in BEST.items():
        assert getattr(found.settings.flexible, name) == pytest.approx(value, rel=0.15)
    assert found.errors[-1][1] < found.errors[0][1]
    assert found.settings.flexible.surface_weight == settings.flexible.surface_weight  # it was not free
    best = replace(settings, flexible=replace(settings.flexible, **BEST))
    same = tune(vj.human(), logs, [truth()] * 3, best, replace(options, evaluations=20))
    assert not same.better and same.settings == best
    with pytest.raises(FitError, match="two logs at least"):
        tune(vj.human(), logs[:1], [truth()], settings, options)


def test_the_command_writes_settings_only_if_they_are_better(fake, tmp_path, capsys):
    names = [tmp_path / f"{name}.mcap" for name in "ab"]
    for name in names:
        name.write_bytes(b"")
        t = truth()
        np.savez(name.with_suffix(".truth.npz"), time_ns=t.time_ns, joints=t.joints, names=np.array(t.names))
    options = TuneSettings(free=tuple(BEST), evaluations=60, seeds=1, judging_seeds=2)
    out = tmp_path / "tuned.toml"
    command = TuneCommand((tmp_path,), out, tune=options)
    assert run_tune(command, Settings()) == 0
    said = capsys.readouterr().out
    assert "judged on b" in said and "edge_weight: 3 ->" in said and "are better" in said
    tuned = read_settings(out, Settings())
    assert tuned.tracker == "flexible" and tuned.flexible.edge_weight > 4.5
    assert run_tune(command, Settings()) == 2 and "--overwrite" in capsys.readouterr().err
    best = replace(vj.preset("flexible"), flexible=replace(FlexibleSettings(), **BEST))
    assert run_tune(replace(command, overwrite=True), best) == 0
    assert "No settings are written" in capsys.readouterr().out and not out.exists()
    assert run_tune(replace(command, out=tmp_path / "tuned"), best) == 2
