"""Disks that are full and processes that end between two writes: a sentence, no half files, and the same bits after."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.faults import Killed, fail_writing, killed_at
from tests.support.small_logs import SETTINGS, arrays_of, assert_same, small_body, small_log
from voodoo_jax.batch.replay import NotSummedUp, Outcome, replay

RESULTS = ("a.voodoo.mcap", "a.tracks.npz")
EXTRAS = {"a.png": {"picture": True}, "a.html": {"html": True}}
EXTRAS |= {f"a.{end}": {"export": [name]} for name, end in (("csv", "csv"), ("bvh", "bvh"), ("gltf", "glb"))}
SUMS = {"replay.jsonl": {}, "report.html": {"report": True}}


@pytest.fixture(scope="module")
def two_logs(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("logs")
    return [small_log(folder / f"{name}.mcap", 5, seed) for seed, name in enumerate("ab")]


@pytest.fixture(scope="module")
def reference(two_logs, tmp_path_factory):
    """What an undisturbed run writes."""
    out = tmp_path_factory.mktemp("reference")
    run(two_logs, out)
    return arrays_of(out)


def run(logs: list[Path], out: Path, **more) -> list[Outcome]:
    return replay(logs, out, small_body(), SETTINGS, quiet=True, **more)


def names(out: Path) -> set[str]:
    return {path.name for path in out.iterdir()}


def whole(out: Path, reference, *more: str) -> None:
    """All results are there to the last bit, and nothing half-written beside them."""
    assert_same(arrays_of(out), reference)
    wanted = {f"{log}{end}" for log in "ab" for end in (".tracks.npz", ".voodoo.mcap")}
    others = {name.replace("a.", "b.", 1) for name in more if name.startswith("a.")}
    assert names(out) == {*wanted, "replay.jsonl", *more, *others}


# bytes that the disk has room for; -1: the complete file cannot be moved to its place
@pytest.mark.parametrize("room", [300, -1])
@pytest.mark.parametrize("name", RESULTS)
def test_a_result_that_cannot_be_written_costs_its_log(name, room, two_logs, reference, tmp_path, monkeypatch):
    with monkeypatch.context() as faulty:
        fail_writing(faulty, name, room)
        bad, good = run(two_logs, tmp_path)
    assert bad.status == "failed" and good.ok
    assert f"{name}' cannot be written: the disk" in bad.error and "name another folder" in bad.error
    assert "unexpected" not in bad.error and name not in names(tmp_path)
    assert not any(left.startswith(".") for left in names(tmp_path))
    assert [o.skipped for o in run(two_logs, tmp_path)] == [False, True]
    whole(tmp_path, reference)


@pytest.mark.parametrize("name", EXTRAS)
def test_what_is_made_of_tracks_costs_no_tracks(name, two_logs, reference, tmp_path, monkeypatch):
    with monkeypatch.context() as faulty:
        fail_writing(faulty, name, 0)
        bad, good = run(two_logs, tmp_path, **EXTRAS[name])
    assert bad.ok and good.ok and name not in names(tmp_path)
    (told,) = (text for text in bad.file_notes if text.startswith("No "))
    assert f"{name}' cannot be written: the disk" in told
    again = run(two_logs, tmp_path, **EXTRAS[name])
    assert [o.skipped for o in again] == [True, True] and not any(o.file_notes for o in again)
    whole(tmp_path, reference, name)


@pytest.mark.parametrize("room", [100, -1])
@pytest.mark.parametrize("name", SUMS)
def test_sums_that_cannot_be_written_are_told_when_all_is_done(name, room, two_logs, reference, tmp_path, monkeypatch):
    with monkeypatch.context() as faulty:
        fail_writing(faulty, name, room)
        with pytest.raises(NotSummedUp, match=f"{name}' cannot be written: the disk") as caught:
            run(two_logs, tmp_path, **SUMS[name])
    assert [o.status for o in caught.value.outcomes] == ["tracked"] * 2 and name not in names(tmp_path)
    assert [o.skipped for o in run(two_logs, tmp_path, **SUMS[name])] == [True, True]
    whole(tmp_path, reference, *({name} - {"replay.jsonl"}))


@pytest.mark.parametrize("moved", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("name", [*RESULTS, "a.csv", "replay.jsonl"])
def test_a_process_that_ends_between_two_writes(name, moved, two_logs, reference, tmp_path, monkeypatch):
    with monkeypatch.context() as faulty:
        killed_at(faulty, name, moved)
        with pytest.raises(Killed):
            run(two_logs, tmp_path, export=["csv"])
    assert (name in names(tmp_path)) == moved
    left = [path for path in tmp_path.iterdir() if path.name.startswith(".")]
    assert bool(left) != moved
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:  # whose number those would have that were killed
        ended.wait()
    for path in left:
        path.rename(path.with_name(path.name.replace(f".{os.getpid()}.", f".{ended.pid}.")))
    done = run(two_logs, tmp_path, export=["csv"])
    assert all(o.ok for o in done)
    assert done[0].skipped == (name not in RESULTS or (name == "a.tracks.npz" and moved))
    whole(tmp_path, reference, "a.csv")
