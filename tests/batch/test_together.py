"""Many recordings as one batch: each gets what it gets alone, on one device and on several."""

import os
import subprocess
import sys
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import voodoo_jax as vj
from tests.support.helpers import SOLVE, all_finite, two_limb_frames, two_limbs, wait_for
from tests.support.small_logs import FLAGS, SETTINGS, arrays_of, assert_same, small_body, small_log
from voodoo_jax.batch import lanes
from voodoo_jax.batch.lanes import in_turns
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import TrackSettings
from voodoo_jax.solve.padding import pad_frames
from voodoo_jax.solve.scan import NOBODY, Visits, at_rest, options_from, track_visits
from voodoo_jax.storage import cores
from voodoo_jax.trackers.shared import sequence


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    return [vj.read_log(small_log(folder / f"{n}.mcap", n, seed=n)) for n in (7, 20, 12)]


def assert_equal_tracks(one: vj.Tracks, other: vj.Tracks) -> None:
    for name in ("joints", "rotation", "translation", "status", "residual", "steps", "limb_covariance"):
        np.testing.assert_array_equal(one.rows()[name], other.rows()[name], err_msg=name)


def test_each_gets_what_it_gets_alone(recordings):
    body = small_body()
    alone = [vj.track(body, recording, SETTINGS) for recording in recordings]
    programs = lanes.program_of(False)._cached._cache_size()
    for count in (1, 2, 3):  # one program, whatever is beside it and however long
        together = vj.track_many(body, recordings[:count], SETTINGS, lanes=2)
        assert [t.source for t in together] == [r.path for r in recordings[:count]]
        for one, other in zip(alone, together):
            assert one.tracked.any()
            assert_equal_tracks(one, other)
    assert lanes.program_of(False)._cached._cache_size() - programs <= 2  # with one lane, and with two


def test_spans_of_a_recording_ask_one_after_the_other(recordings, monkeypatch):
    """Members of a batch answer each other's requests in turns: a span that is refined aside would get the answer of
    the next one."""
    monkeypatch.setattr(sequence, "SPAN", 8)
    monkeypatch.setattr(sequence, "OVERLAP", 2)
    monkeypatch.setattr(cores, "own_cores", lambda: 2)
    settings = replace(SETTINGS, track=replace(SETTINGS.track, chunk=8, skip=()))
    body, some = small_body(), recordings[1:]
    for one, recording in zip(vj.track_many(body, some, settings, lanes=2), some):
        assert_equal_tracks(one, vj.track(body, recording, settings))


def test_one_recording_with_many_settings_and_bodies(recordings):
    body, recording = small_body(), recordings[1]
    several = [replace(SETTINGS, solve=replace(SETTINGS.solve, max_steps=n)) for n in (2, 9)]
    found = vj.track_many(body, recording, several, lanes=2)
    assert [t.evidence.steps.max() <= n for t, n in zip(found, (2, 9))] == [True, True]
    assert not np.array_equal(found[0].joints, found[1].joints)
    for one, settings in zip(found, several):
        assert_equal_tracks(one, vj.track(body, recording, settings))
    longer = vj.track_many([body, vj.load_body("arm")], recording, SETTINGS, lanes=1)
    assert_equal_tracks(*longer)


def test_the_time_to_compile_is_told_apart(recordings):
    settings = replace(SETTINGS, track=replace(SETTINGS.track, chunk=8))  # another program than those before
    first, again = (vj.track_many(small_body(), recordings[0], settings)[0] for _ in range(2))
    assert first.compile_seconds > 0.1 > again.compile_seconds


def test_arguments_that_do_not_fit(recordings):
    with pytest.raises(ValueError, match="2 bodies, 3 recordings, 1 settings"):
        vj.track_many([small_body()] * 2, recordings, SETTINGS)
    with pytest.raises(ValueError, match="lanes = -1"):
        vj.track_many(small_body(), recordings, SETTINGS, lanes=-1)
    assert vj.track_many(small_body(), [], SETTINGS) == []


def test_an_error_says_which_recording_it_was(recordings):
    wrong = replace(SETTINGS, features=replace(SETTINGS.features, names=("no equals sign",)))
    with pytest.raises(ValueError, match="no equals sign") as problem:
        vj.track_many(small_body(), recordings[:2], [SETTINGS, wrong], lanes=2)
    assert "Number 1 of 2" in problem.value.__notes__[0] and recordings[1].path in problem.value.__notes__[0]


def asked(count: int, seed: int):
    """What one recording asks of the program: five frames of a body of two limbs, one of them empty."""
    body = two_limbs()
    chunk = pad_frames(two_limb_frames([count, 0, count, count // 2, count], seed), 256, 5, None, 1)
    states = at_rest(jax.tree.map(lambda x: np.stack([x, x + np.float32(0.02) * (x.shape[-1] == 3)]), body.rest))
    frame, track = np.arange(8) % 5, np.array([0, 0, 1, 0, NOBODY, 0, 1, NOBODY])
    return body, options_from(SOLVE, TrackSettings()), states, chunk.points, chunk.seconds, Visits(frame, track), None


def stacked(*each):
    return jax.tree.map(lambda *x: np.stack([np.asarray(a) for a in x]), *each)


in_step = eqx.filter_jit(lanes.in_lockstep)


def assert_alike(one, other, visits: Visits, tolerance: float) -> None:
    """The states of all tracks, and the steps of visits that somebody makes."""
    busy = np.flatnonzero(visits.track != NOBODY)
    (states, steps), (other_states, other_steps) = one, other
    for a, b in zip(jax.tree.leaves(states), jax.tree.leaves(other_states), strict=True):
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)
    for name in ("poses", "residual", "explained", "limb_weight", "points"):
        for a, b in zip(*(jax.tree.leaves(getattr(s, name)) for s in (steps, other_steps)), strict=True):
            np.testing.assert_allclose(a[busy], b[busy], rtol=tolerance, atol=tolerance, err_msg=name)


def test_in_step_or_one_after_the_other_is_the_same():
    mine = [asked(count, seed) for count, seed in ((200, 0), (80, 1), (30, 2))]
    found = in_step(*stacked(*mine))
    for k, each in enumerate(mine):
        assert_alike(jax.tree.map(lambda x, k=k: x[k], found), track_visits(*each), each[5], 2e-3)


def test_what_is_wrong_with_one_recording_does_not_touch_the_others():
    """To the last bit: without points, with numbers that are none, with nothing to do (docs/numerics.md#padding,
    #slowest, #bad-frames)."""
    good, other = asked(200, 0), asked(80, 1)
    hidden = eqx.tree_at(lambda a: a[3].weight, asked(200, 2), np.zeros((5, 256), np.float32))
    broken = eqx.tree_at(lambda a: a[3].xyz, asked(200, 2), np.full((5, 256, 3), np.nan, np.float32))
    idle = (*other[:5], Visits(other[5].frame, np.full(8, NOBODY)), None)
    first = in_step(*stacked(good, other, other))
    assert all_finite(jax.tree.map(lambda x: x[0], first[0]))
    for place, beside in ((0, (hidden, other)), (0, (broken, idle)), (2, (idle, broken)), (1, (other, hidden))):
        lanes_ = list(beside)
        lanes_.insert(place, good)
        found = in_step(*stacked(*lanes_))
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(first), strict=True):
            np.testing.assert_array_equal(a[place], b[0])


def test_who_has_nothing_to_do_keeps_its_state():
    mine = asked(200, 0)
    idle = (*mine[:5], Visits(mine[5].frame, np.full(8, NOBODY)), None)
    states, _ = in_step(*stacked(mine, idle))
    for before, after in zip(jax.tree.leaves(mine[2]), jax.tree.leaves(states), strict=True):
        np.testing.assert_array_equal(before, after[1])
        assert jnp.shape(after)[0] == 2


def test_tasks_take_turns_and_are_answered_together():
    def task(n: int):
        return lambda ask: sum(ask(n, k) for k in range(n))

    batches = []

    def answer(some: list[tuple]) -> list[int]:
        batches.append(some)
        return [10 * n + k for n, k in some]

    done = dict(in_turns([task(n) for n in (3, 0, 1, 2)], 2, answer))
    assert done == {3: 41, 0: 93, 1: 0, 2: 10}
    assert max(map(len, batches)) == 2 and sorted(sum(batches, [])) == [(1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2)]


def test_a_task_that_nobody_waits_for_any_more_ends():
    ended = []

    def task(ask):
        try:
            ask(1)
        finally:
            ended.append(True)

    def fails(ask):
        ask(2)
        raise KeyError("lost")

    with pytest.raises(KeyError, match="lost"):
        for _ in in_turns([fails, task, task], 3, lambda some: [0] * len(some)):
            pass
    wait_for(lambda: len(ended) == 2, 5.0)


@pytest.mark.parametrize("devices", [1, 2])
def test_replay_as_one_batch(recordings, devices, tmp_path):
    """The same files as by workers on one device, and the same ones again on two, whatever is beside a log."""
    logs = [recording.path for recording in recordings]
    out = [tmp_path / name for name in ("local", "batch", "fewer")]
    assert main(["replay", *logs, "--out", str(out[0]), "--workers", "1", *FLAGS]) == 0
    missing = str(tmp_path / "missing.mcap")
    environment = dict(os.environ)
    environment["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
    for given, folder, status in (([*logs, missing], out[1], 1), (logs[2:], out[2], 0)):
        command = [sys.executable, "-m", "voodoo_jax.cli", "replay", *given, "--out", str(folder), "--engine", "batch"]
        ran = subprocess.run([*command, *FLAGS], env=environment, capture_output=True, text=True, timeout=300)
        assert ran.returncode == status, ran.stdout + ran.stderr
    local, batch, fewer = map(arrays_of, out)
    if devices == 1:
        assert_same(local, batch)
    else:
        assert local.keys() == batch.keys()
        for name, arrays in local.items():
            np.testing.assert_allclose(arrays["joints"], batch[name]["joints"], atol=0.005, err_msg=name)
    assert_same(fewer, {name: batch[name] for name in fewer})
