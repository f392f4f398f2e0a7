"""Many logs: workers, shards, order and engine change nothing; finished ones are skipped; a killed run is resumed."""

import json
import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import jax
import jax.monitoring
import pytest

from tests.support.helpers import wait_for
from tests.support.small_logs import FLAGS, SETTINGS, arrays_of, assert_same, small_body, small_log
from voodoo_jax.batch.log_job import Job
from voodoo_jax.batch.process_pool import default_workers, in_workers, usable_cores
from voodoo_jax.batch.replay import Outcome, replay
from voodoo_jax.batch.worker_start import can_copy, environment
from voodoo_jax.cli.main import main
from voodoo_jax.config.output_style import Style
from voodoo_jax.storage.cores import own_cores

FRAMES = {"a": 12, "b": 5, "c": 33, "d": 20}


@pytest.fixture(scope="module")
def some_logs(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("logs")
    return [small_log(folder / f"{name}.mcap", n, seed) for seed, (name, n) in enumerate(FRAMES.items())]


@pytest.fixture(scope="module")
def reference(some_logs, tmp_path_factory) -> Path:
    """All logs one after the other in this process."""
    out = tmp_path_factory.mktemp("reference")
    outcomes = replay(some_logs, out, small_body(), SETTINGS, quiet=True, compile_cache="")
    assert [o.status for o in outcomes] == ["tracked"] * 4, [str(o) for o in outcomes]
    assert [o.frames for o in outcomes] == list(FRAMES.values()) and not any(o.skipped for o in outcomes)
    assert [Path(o.path) for o in outcomes] == some_logs  # in the order given, whichever was done first
    return out


def rows(folder: Path, name: str = "replay.jsonl") -> dict[str, dict]:
    lines = [json.loads(line) for line in (folder / name).read_text().splitlines()]
    return {Path(row["log"]).name: row for row in lines}


def test_workers_and_order_change_nothing(some_logs, reference, tmp_path):
    outcomes = replay(some_logs[::-1], tmp_path, small_body(), SETTINGS, quiet=True, workers=2, compile_cache="")
    assert [Path(o.path) for o in outcomes] == some_logs[::-1] and all(o.ok for o in outcomes)
    assert_same(arrays_of(tmp_path), arrays_of(reference))


def test_shards_change_nothing_and_share_nothing(some_logs, reference, tmp_path):
    mixed = random.Random(0).sample(some_logs, 4)
    first = replay(some_logs, tmp_path, small_body(), SETTINGS, quiet=True, shard="1/2")
    second = replay(mixed, tmp_path, small_body(), SETTINGS, quiet=True, shard="2/2")
    assert (
        len(first) + len(second) == 4
        and len(first) * len(second)
        and not {o.path for o in first} & {o.path for o in second}
    )
    assert_same(arrays_of(tmp_path), arrays_of(reference))
    named = [*rows(tmp_path, "replay-1-of-2.jsonl"), *rows(tmp_path, "replay-2-of-2.jsonl")]
    assert sorted(named) == [path.name for path in some_logs]


def test_one_program_whatever_the_lengths(some_logs, reference, tmp_path):
    """A log of a length and of numbers of points that no other has had: nothing of the tracking is compiled for it."""
    import voodoo_jax.trackers.shared.runner

    programs = voodoo_jax.trackers.shared.runner.track_visits.ready
    before = len(programs)
    points = {int(number) for arrays in arrays_of(reference).values() for number in arrays["points"]}
    assert len(points) > 10
    compiled = []

    def count(event: str, seconds: float, fun_name: str = "", **_: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(fun_name)

    new = small_log(tmp_path / "new.mcap", 27, 9)
    jax.monitoring.register_event_duration_secs_listener(count)
    try:
        (outcome,) = replay([new], tmp_path, small_body(), SETTINGS, quiet=True)
    finally:
        jax.monitoring.unregister_event_duration_listener(count)
    assert outcome.ok and outcome.frames == 27
    assert len(programs) == before
    # what is still compiled for every length: joint centres of all frames, and arrays on their way to them
    assert set(compiled) <= {"jit(joint_centres)", "jit(stage)"} and len(compiled) <= 4, compiled


def test_finished_logs_are_skipped_and_others_done(some_logs, reference, tmp_path, capsys):
    """Each log's results are touched in another way; only what is whole and still right is skipped."""
    logs = [tmp_path / path.name for path in some_logs]
    for log, path in zip(logs, some_logs):
        log.write_bytes(path.read_bytes())  # a copy of a log is the same log
    out, missing = tmp_path / "out", tmp_path / "missing.mcap"
    out.mkdir()
    for file in reference.iterdir():
        (out / file.name).write_bytes(file.read_bytes())
    a, b, c, d = logs
    (out / "b.voodoo.mcap").unlink()
    whole = (out / "c.tracks.npz").read_bytes()
    (out / "c.tracks.npz").write_bytes(whole[: len(whole) // 2])
    d.write_bytes(some_logs[0].read_bytes())  # another log of this name
    capsys.readouterr()
    outcomes = replay([*logs, missing], out, small_body(), SETTINGS)
    assert [o.skipped for o in outcomes] == [True, False, False, False, False]
    assert [o.status for o in outcomes] == ["tracked"] * 4 + ["failed"]
    printed = capsys.readouterr().out
    assert "a.mcap: skipped, finished before: 12 frames" in printed and "missing.mcap: FAILED" in printed
    assert outcomes[0].tracks is not None and len(outcomes[0].tracks.time_ns) == 12 and outcomes[4].tracks is None
    got, wanted = arrays_of(out), arrays_of(reference)
    assert_same(
        {name: got[name] for name in got if name != "d.tracks.npz"},
        {name: wanted[name] for name in wanted if name != "d.tracks.npz"},
    )
    assert_same({"a": got["d.tracks.npz"]}, {"a": wanted["a.tracks.npz"]})
    summary = rows(out)
    assert list(summary) == ["a.mcap", "b.mcap", "c.mcap", "d.mcap", "missing.mcap"]
    assert summary["missing.mcap"]["status"] == "failed" and "missing.mcap" in summary["missing.mcap"]["error"]
    assert summary["a.mcap"]["skipped"] and summary["c.mcap"]["frames"] == 33

    missing.write_bytes(some_logs[1].read_bytes())  # the one that failed is tried again
    outcomes = replay([*logs, missing], out, small_body(), SETTINGS, quiet=True)
    assert [o.skipped for o in outcomes] == [True] * 4 + [False] and outcomes[4].ok
    assert rows(out)["missing.mcap"]["status"] == "tracked"
    missing.write_text("a diary")
    outcomes = replay([missing], out, small_body(), SETTINGS, quiet=True)
    assert outcomes[0].status == "failed" and "from an earlier run" in outcomes[0].error


def test_other_settings_and_again_do_logs_anew(some_logs, reference, tmp_path):
    log, out = some_logs[1], tmp_path
    for file in reference.glob("b.*"):
        (out / file.name).write_bytes(file.read_bytes())

    def skipped(settings=SETTINGS, **more) -> bool:
        return replay([log], out, small_body(), settings, quiet=True, **more)[0].skipped

    assert skipped()
    assert not skipped(again=True) and skipped()
    assert not skipped(smooth_seconds=0.05) and skipped(smooth_seconds=0.05) and not skipped()
    other = replace(SETTINGS, solve=replace(SETTINGS.solve, prior=0.0004))
    assert not skipped(settings=other) and skipped(settings=other)
    named = Style(names="common")
    assert not skipped(style=named) and skipped(style=named)


def test_a_picture_of_a_finished_log(some_logs, reference, tmp_path):
    for file in reference.glob("b.*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    npz, png = tmp_path / "b.tracks.npz", tmp_path / "b.png"
    before = npz.stat().st_mtime_ns
    for _ in range(2):
        drawn = replay([some_logs[1]], tmp_path, small_body(), SETTINGS, quiet=True, picture=True)[0]
        assert drawn.skipped and drawn.picture == str(png) and npz.stat().st_mtime_ns == before
        stamp = png.stat().st_mtime_ns
    assert png.stat().st_mtime_ns == stamp


def test_exports_of_a_finished_log(some_logs, reference, tmp_path):
    """They are made of the tracks that are there, and not made again."""
    for file in reference.glob("b.*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    npz, bvh = tmp_path / "b.tracks.npz", tmp_path / "b.bvh"
    before = npz.stat().st_mtime_ns
    for _ in range(2):
        done = replay([some_logs[1]], tmp_path, small_body(), SETTINGS, quiet=True, html=True, export=["csv", "bvh"])[0]
        assert done.skipped and npz.stat().st_mtime_ns == before
        stamp = bvh.stat().st_mtime_ns
    assert bvh.stat().st_mtime_ns == stamp
    assert {path.name for path in tmp_path.glob("b*.csv")} == {"b.csv"}
    assert (tmp_path / "b.html").stat().st_size > 10_000 and not done.file_notes
    with pytest.raises(ValueError, match="no format 'fbx'"):
        replay([some_logs[1]], tmp_path, small_body(), SETTINGS, quiet=True, export=["fbx"])


def cpu_seconds(pid: int) -> float:
    """Processor time that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def endless_log(path: Path) -> None:
    """A log that takes hours to read: a run cannot end by itself before it is stopped."""
    with open(path, "wb") as stream:
        stream.truncate(1 << 42)  # takes no room on the disk


def start(logs: list[Path], out: Path, *words: str) -> "subprocess.Popen[str]":
    command = [
        sys.executable,
        "-P",
        "-m",
        "voodoo_jax.cli",
        "replay",
        *map(str, logs),
        "--out",
        str(out),
        *FLAGS,
        *words,
    ]
    # what a shell starts in the background ignores Ctrl-C, and so would all that it starts
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        env = {**os.environ, "PYTHONUNBUFFERED": "1"}
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def ended(running: "subprocess.Popen[str]") -> Iterator["subprocess.Popen[str]"]:
    """The process, which does not outlive a test that fails."""
    with running:
        try:
            yield running
        finally:
            running.kill()


def children(pid: int) -> list[int]:
    """Processes that a process has started, from whichever of its threads."""
    out = []
    for found in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # a thread that has ended
            out += [int(word) for word in found.read_text().split()]
    return out


def command_of(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_text()


def busy(pid: int) -> list[int]:
    """Copies of a process that have worked for a second; other programs that it starts are none."""
    found = []
    for child in children(pid):
        with suppress(OSError):  # one that has ended
            found += [child] if command_of(child) == command_of(pid) and cpu_seconds(child) > 1 else []
    return found


def test_a_worker_whose_answer_nobody_takes_ends_without_a_word():
    """A parent that is killed closes both pipes at once; the worker may answer before it sees that no job comes."""
    command = [sys.executable, "-P", "-m", "voodoo_jax.batch.worker_process"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as worker:
        assert worker.stdout is not None and worker.stderr is not None
        worker.stdout.close()  # its input stays open
        assert worker.stderr.read() == b"" and worker.wait(60) == 1


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc to see the workers")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT], ids=["killed", "interrupted"])
def test_a_run_that_ends_in_the_middle_is_resumed(how, some_logs, reference, tmp_path):
    """Nothing is lost, nothing is done twice, no worker goes on, and the results are those of an undisturbed run."""
    out, endless = tmp_path / "out", tmp_path / "endless.mcap"
    endless_log(endless)
    running = start([*some_logs, endless], out, "--workers", "2")
    wait_for(lambda: len(list(out.glob("*.tracks.npz"))) >= 1 or running.poll() is not None)
    workers = children(running.pid)
    running.send_signal(how)
    printed, errors = running.communicate(timeout=60)
    assert running.returncode == (-signal.SIGKILL if how == signal.SIGKILL else 130), errors
    wait_for(lambda: not any(Path(f"/proc/{pid}/cmdline").exists() for pid in workers), 20)
    assert len(workers) == 2 and "Traceback" not in errors
    finished = {p.name: p.stat().st_mtime_ns for p in out.glob("*.tracks.npz")}
    assert 1 <= len(finished) <= 4
    assert_same(arrays_of(out), {n: a for n, a in arrays_of(reference).items() if n in finished})
    if how == signal.SIGINT:
        assert "finished logs are complete" in errors
        assert {f"{Path(name).stem}.tracks.npz" for name in rows(out)} <= set(finished)

    outcomes = replay(some_logs, out, small_body(), SETTINGS, quiet=True)
    assert {Path(o.npz).name for o in outcomes if o.skipped} == set(finished)
    assert all((out / name).stat().st_mtime_ns == when for name, when in finished.items())
    assert_same(arrays_of(out), arrays_of(reference))
    stems = sorted(FRAMES)
    wanted = ["replay.jsonl", *(f"{s}.{end}" for s in stems for end in ("tracks.npz", "voodoo.mcap"))]
    assert sorted(p.name for p in out.iterdir()) == sorted(wanted)
    assert [row["status"] for row in rows(out).values()] == ["tracked"] * 4


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc to see the workers")
def test_workers_of_the_command_are_copies_of_it_and_are_replaced_where_they_die(some_logs, reference, tmp_path):
    """Each worker that is killed takes one log with it; the endless ones, the largest, come first."""
    out, endless = tmp_path / "out", [tmp_path / f"endless{k}.mcap" for k in range(2)]
    for log in endless:
        endless_log(log)
    with ended(start([*some_logs, *endless], out, "--workers", "2")) as running:
        wait_for(lambda: len(children(running.pid)) == 2 or running.poll() is not None)
        first = children(running.pid)
        assert {command_of(pid) for pid in first} == {command_of(running.pid)}
        wait_for(lambda: min(map(cpu_seconds, first)) > 1)  # both are reading
        for pid in first:
            os.kill(pid, signal.SIGKILL)
        wait_for(lambda: len({*children(running.pid)} - {*first}) == 2 or running.poll() is not None)
        new = lambda: {command_of(pid) for pid in children(running.pid) if pid not in first}  # noqa: E731
        # a process that was made a moment ago has its parent's command still
        wait_for(lambda: any("worker_process" in command for command in new()) or running.poll() is not None)
        seen = new()
        printed, errors = running.communicate(timeout=100)
    assert running.returncode == 1 and "4 of 6 logs tracked" in printed, errors
    assert printed.count("SIGKILL") == 2 and any("worker_process" in command for command in seen)
    assert_same(arrays_of(out), arrays_of(reference))


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc to see the worker")
@pytest.mark.parametrize(
    "how, said", [(signal.SIGSEGV, "ended by SIGSEGV"), (signal.SIGSTOP, "--log-timeout")], ids=["crash", "hang"]
)
def test_one_worker_is_as_safe_as_two(how, said, some_logs, reference, tmp_path):
    """A log that ends the process it is tracked in, or never comes back, costs itself only with --workers 1, too."""
    out, endless = tmp_path / "out", tmp_path / "endless.mcap"
    endless_log(endless)
    words = ["--workers", "1", *(["--log-timeout", "20"] if how == signal.SIGSTOP else [])]
    with ended(start([some_logs[1], endless], out, *words)) as running:
        # it reads the endless one, the largest, first
        wait_for(lambda: busy(running.pid) or running.poll() is not None)
        (worker,) = busy(running.pid)
        os.kill(worker, how)
        printed, errors = running.communicate(timeout=300)  # it may have to compile
    assert running.returncode == 1 and "1 of 2 logs tracked" in printed and "Traceback" not in errors, errors
    (line,) = (line for line in printed.splitlines() if line.startswith("endless.mcap: FAILED"))
    assert said in line
    assert_same(arrays_of(out), {"b.tracks.npz": arrays_of(reference)["b.tracks.npz"]})


def test_a_process_is_copied_only_while_it_has_one_thread():
    code = """
import threading
from voodoo_jax.batch.worker_start import can_copy
for _ in range(200):  # a thread that has ended is none, however lately
    thread = threading.Thread(target=int)
    thread.start()
    thread.join()
    assert can_copy()
threading.Thread(target=threading.Event().wait, daemon=True).start()
assert not can_copy()
"""
    if sys.platform.startswith("linux"):
        subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"})
    else:
        assert not can_copy()


class Poison(Job):
    """Kills the process that receives it."""

    def __reduce__(self):
        return exec, (f"import os; os.kill(os.getpid(), {int(signal.SIGKILL)})",)


def test_a_worker_that_dies_takes_one_log_with_it(tmp_path):
    def job(kind, name: str) -> Job:
        return kind(str(tmp_path / name), str(tmp_path), small_body(), SETTINGS, 0.0, "", (), False)

    bad = tmp_path / "bad.mcap"
    bad.write_text("no log\n")
    jobs = [job(Job, "bad.mcap"), job(Poison, "deadly.mcap"), job(Job, "bad.mcap"), job(Job, "gone.mcap")]
    outcomes: dict[int, Outcome] = dict(in_workers(jobs, lambda number, share: None, 1))
    assert sorted(outcomes) == [0, 1, 2, 3] and not any(o.ok for o in outcomes.values())
    assert "SIGKILL" in outcomes[1].error and "--workers" in outcomes[1].error
    assert "MCAP" in outcomes[0].error and "MCAP" in outcomes[2].error and "no file" in outcomes[3].error


def test_a_worker_that_cannot_start(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false" if os.path.exists("/bin/false") else "/usr/bin/false")
    job = Job(str(tmp_path / "a.mcap"), str(tmp_path), small_body(), SETTINGS, 0.0, "", (), False)
    ((number, outcome),) = in_workers([job], lambda number, share: None, 1)
    assert number == 0 and "did not start" in outcome.error and "--workers 1" in outcome.error


def test_cores_are_counted(monkeypatch):
    assert 1 <= default_workers(1000) <= usable_cores() and default_workers(1) == 1
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(
        "voodoo_jax.batch.process_pool.find_spec", lambda name: object() if name == "jax_plugins" else None
    )
    assert default_workers(1000) == 1
    assert 1 <= usable_cores() <= (os.cpu_count() or 1)
    # a worker has its share, of which XLA takes one
    share = environment(1)
    assert set(share.values()) == {"1", share["XLA_PYTHON_CLIENT_PREALLOCATE"]} and environment(3)["PJRT_NPROC"] == "1"
    monkeypatch.setenv("OMP_NUM_THREADS", share["OMP_NUM_THREADS"])
    assert own_cores() == 1
    for told in ("", "1000", "many"):
        monkeypatch.setenv("OMP_NUM_THREADS", told)
        assert own_cores() == usable_cores()


@pytest.mark.parametrize(
    "words, sentence",
    [(["--workers", "-1"], "--workers -1"), (["--shard", "0/2"], "from 1/8 on"), (["--shard", "x"], "like 2/8")],
)
def test_arguments_that_cannot_be_used(words, sentence, some_logs, tmp_path, capsys):
    assert main(["replay", str(some_logs[0]), "--out", str(tmp_path / "o"), *words]) == 2
    printed = capsys.readouterr().err
    assert sentence in printed and "Traceback" not in printed and not (tmp_path / "o").exists()
