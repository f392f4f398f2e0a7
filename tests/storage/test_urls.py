"""Logs and results behind URLs: fetched and delivered whole, with sentences where something is missing."""

import sys
from pathlib import Path

import fsspec
import pytest

from tests.support.small_logs import SETTINGS, arrays_of, assert_same, small_body, small_log
from voodoo_jax.batch.replay import replay
from voodoo_jax.cli.main import main
from voodoo_jax.storage.urls import byte_size, delivered, expanded, fetched, joined


@pytest.fixture
def store():
    """An object store in memory, empty."""
    system = fsspec.filesystem("memory")
    system.store.clear()
    system.pseudo_dirs[:] = [""]
    yield system
    system.store.clear()


def test_logs_from_a_store_into_a_store(store, tmp_path):
    logs = [small_log(tmp_path / f"{name}.mcap", 8, seed) for seed, name in enumerate("ab")]
    for log in logs:
        store.pipe_file(f"/lab/{log.name}", log.read_bytes())
    local = replay(logs, tmp_path / "out", small_body(), SETTINGS, quiet=True, compile_cache="")
    # workers would not see this process's memory
    far = replay(["memory://lab/*.mcap"], "memory://results/day", small_body(), SETTINGS, quiet=True, workers=2)
    assert [o.status for o in far] == [o.status for o in local] == ["tracked"] * 2, [str(o) for o in far]
    assert [o.path for o in far] == ["memory:///lab/a.mcap", "memory:///lab/b.mcap"]
    names = sorted(name.rsplit("/", 1)[-1] for name in store.find("/results/day"))
    assert names == sorted(p.name for p in (tmp_path / "out").iterdir())
    copy = tmp_path / "copy"
    store.get("/results/day", str(copy), recursive=True)
    assert_same(arrays_of(copy), arrays_of(tmp_path / "out"))
    tracks = far[0].tracks
    assert tracks is not None and tracks.source == "memory:///lab/a.mcap" and len(tracks.time_ns) == 8

    again = replay(["memory://lab/*.mcap", "memory://lab/c.mcap"], "memory://results/day", small_body(), SETTINGS, True)
    assert [o.skipped for o in again] == [True, True, False]
    assert "memory://lab/c.mcap" in again[2].error and "cannot be downloaded" in again[2].error
    store.pipe_file("/lab/c.mcap", b"a diary")
    (broken,) = replay(["memory://lab/c.mcap"], "memory://results/day", small_body(), SETTINGS, True)
    assert "'memory://lab/c.mcap'" in broken.error and "MCAP" in broken.error


def test_file_urls_are_paths(tmp_path):
    (tmp_path / "x.mcap").write_text("no log")
    (outcome,) = replay([f"file://{tmp_path}/*.mcap"], f"file://{tmp_path}/out", quiet=True)
    assert outcome.path == str(tmp_path / "x.mcap") and (tmp_path / "out" / "replay.jsonl").exists()


@pytest.mark.parametrize(
    "log, sentence",
    [("nosuch://a/b.mcap", "nosuch"), ("memory://empty/*.mcap", "no log matches")],
    ids=["unknown protocol", "nothing there"],
)
def test_urls_that_cannot_be_used(log, sentence, store, tmp_path, capsys):
    assert main(["replay", log, "--out", str(tmp_path / "o")]) == 2
    printed = capsys.readouterr().err
    assert sentence in printed and log in printed and "Traceback" not in printed and not (tmp_path / "o").exists()


def test_without_fsspec_it_is_said_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    assert main(["replay", "s3://lab/a.mcap", "--out", str(tmp_path / "o")]) == 2
    assert 'pip install "voodoo_jax[urls]"' in capsys.readouterr().err


def test_paths_pass_through(tmp_path):
    (tmp_path / "a[1].mcap").write_bytes(b"12345")
    path = str(tmp_path / "a[1].mcap")
    assert expanded(path) == [path] and byte_size(path) == 5 and byte_size(path + "x") == 0
    with fetched(path) as same, delivered(str(tmp_path)) as folder:
        assert same == path and folder == tmp_path
    assert joined("s3://b/c/", "d") == "s3://b/c/d" and Path(joined("b", "d")) == Path("b/d")


def test_a_folder_stands_for_the_logs_in_it(tmp_path, capsys):
    """And in the folders below, as ROS 2 has them; what was written there, and hidden files, are no logs."""
    logs, bag = tmp_path / "logs", tmp_path / "logs" / "bag"
    bag.mkdir(parents=True)
    for path in (logs / "b.mcap", logs / "a.mcap", bag / "bag_0.mcap"):
        small_log(path, 8, 0)
    for path in (logs / "a.voodoo.mcap", logs / ".c.mcap", logs / "notes.txt", bag / "metadata.yaml"):
        path.write_text("no log")
    (logs / "d.mcap").mkdir()
    names = [str(logs / "a.mcap"), str(logs / "b.mcap"), str(bag / "bag_0.mcap")]
    assert expanded(logs) == names
    outcomes = replay([logs], logs, small_body(), SETTINGS, quiet=True, compile_cache="")
    assert [o.path for o in outcomes] == names and all(o.ok for o in outcomes)
    assert expanded(logs) == names  # with their tracks beside them
    assert main(["info", str(bag), str(logs / "a.mcap")]) == 0
    assert capsys.readouterr().out.count(".mcap") == 2
    for command in ("replay", "info", "fit"):
        assert main([command, str(logs / "d.mcap")]) == 2
        assert "without logs" in capsys.readouterr().err


def test_logs_of_one_name_have_folders_of_their_own(tmp_path, capsys):
    """And the same log named twice is one."""
    for place in ("mon/walk.mcap", "tue/walk.mcap", "tue/run.mcap"):
        (tmp_path / "logs" / place).parent.mkdir(parents=True, exist_ok=True)
        small_log(tmp_path / "logs" / place, 8, len(place))
    (tmp_path / "logs/mon/walk.mcap").write_bytes(b"no log")
    logs, out = [tmp_path / "logs", tmp_path / "logs/tue/run.mcap"], tmp_path / "out"
    outcomes = replay(logs, out, small_body(), SETTINGS, compile_cache="")
    assert [o.name for o in outcomes] == ["mon/walk.mcap", "tue/run.mcap", "tue/walk.mcap"]
    assert [bool(o.npz) for o in outcomes] == [False, True, True]
    assert "mon/walk.mcap: FAILED" in capsys.readouterr().out
    assert sorted(str(path.relative_to(out)) for path in out.rglob("*.npz")) == [
        "tue/run.tracks.npz",
        "tue/walk.tracks.npz",
    ]
    again = replay(logs, out, small_body(), SETTINGS, quiet=True, compile_cache="")
    assert [o.skipped for o in again] == [False, True, True]
    assert len((out / "replay.jsonl").read_text().splitlines()) == 3


def test_nothing_is_delivered_of_what_failed(store):
    with pytest.raises(KeyError), delivered("memory://results") as folder:
        (folder / "half").write_text("of it")
        raise KeyError
    assert not store.exists("/results/half")
