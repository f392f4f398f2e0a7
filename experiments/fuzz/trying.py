"""A log tried in a process of its own: what came of it, and what it cost.

python -m experiments.fuzz.trying read|track FOLDER takes paths of logs, each a line of JSON, and answers with a line
for each. `Watched` is the other end.
"""

import json
import os
import resource
import select
import subprocess
import sys
import time
import traceback
import warnings
import zlib
from pathlib import Path
from typing import Any, Literal

Mode = Literal["read", "track"]
ROOM = 8 << 30  # bytes of addresses: above is out of memory
SECONDS = 60  # of a processor, docs/limits.md
PEAK = 2 << 30  # bytes of memory, docs/limits.md
WALL = 600  # seconds after which an input is given up, however busy the machine is


def _read(path: str) -> dict[str, Any]:
    """What reading gives."""
    import numpy as np

    from voodoo_jax.io.log_reader import read_log

    recording = read_log(path)
    frames = {str(f.time_ns): zlib.crc32(f.points.tobytes()) for f in recording}
    finite = all(np.isfinite(f.points).all() for f in recording)
    return {"frames": frames, "count": len(recording), "finite": finite, "notes": list(recording.notes)}


def _tracker(folder: str) -> Any:
    """A function that gives what `voodoo-jax replay` makes of a log."""
    from dataclasses import replace

    import numpy as np

    from voodoo_jax.batch.log_job import Job, do_job
    from voodoo_jax.batch.resume import recipe_key
    from voodoo_jax.compile.cache_dir import cache_folder
    from voodoo_jax.config.options import Settings
    from voodoo_jax.model.body_file import load_on_host

    body, settings = load_on_host("human"), Settings()
    key = recipe_key(body, settings, 0.0)
    job = Job("", folder, body, settings, 0.0, key, (), False, compile_cache=cache_folder(""))

    def track(path: str) -> dict[str, Any]:
        done = do_job(replace(job, log=path, size=os.path.getsize(path)))
        found = {"error": done.error, "notes": list(done.notes), "count": done.frames, "said": str(done)}
        found |= {"compiling": done.compile_seconds, "share": done.tracked}
        if done.npz:
            with np.load(done.npz, allow_pickle=False) as data:
                times, joints, tracked = data["time_ns"], data["joints"], data["tracked"]
            found["finite"] = bool(np.isfinite(joints[tracked]).all())
            found["far"] = float(np.abs(joints[tracked]).max(initial=0.0)) if found["finite"] else 0.0
            found["joints"] = {str(t): j.tolist() for t, j, ok in zip(times, joints, tracked) if ok}
        return found

    return track


def _memory() -> int:
    words = Path("/proc/self/status").read_text().split()
    return 1024 * int(words[words.index("VmHWM:") + 1])


def tried(path: str, work: Any) -> dict[str, Any]:
    """What `info` and the work say of a log, with traces of what nobody expected, and what it cost."""
    from voodoo_jax.io.container import LogError
    from voodoo_jax.io.log_reader import survey

    Path("/proc/self/clear_refs").write_text("5")  # the largest memory so far is that of now
    began, found = time.process_time(), {"info": "", "error": "", "trace": "", "notes": []}
    for name, step in (("info", lambda: {"info": str(survey(path))}), ("error", lambda: work(path))):
        try:
            found |= step()
        except LogError as problem:
            found[name] = str(problem)
        except Exception:
            found["trace"] += traceback.format_exc()[-1500:]
    return found | {"peak": _memory(), "seconds": time.process_time() - began}


def main(mode: str, folder: str) -> None:
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (ROOM, ROOM))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    os.chdir(folder)
    work = _read if mode == "read" else _tracker(folder)
    for line in sys.stdin:
        answers.write(json.dumps(tried(json.loads(line), work)) + "\n")
        answers.flush()


class Watched:
    """A process that tries logs, started anew where one took it along."""

    def __init__(self, mode: Mode, folder: Path):
        self.mode, self.folder = mode, folder
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> "Watched":
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def ask(self, path: Path) -> dict[str, Any]:
        """What `tried` found; {"crash": exit status} or {"hang": seconds of the processor}."""
        if self._process is None:
            words = [sys.executable, "-m", "experiments.fuzz.trying", self.mode, str(self.folder)]
            with open(self.folder / "trying.log", "a") as log:
                self._process = subprocess.Popen(
                    words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
                )
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        began, before = time.monotonic(), self._seconds()
        try:
            process.stdin.write(json.dumps(str(path)) + "\n")
            process.stdin.flush()
            while time.monotonic() - began < WALL and self._seconds() - before < 3 * SECONDS:
                if select.select([process.stdout], [], [], 1)[0]:
                    return json.loads(process.stdout.readline())
        except (OSError, ValueError):  # it is gone
            process.wait()
            self._end()
            return {"crash": process.returncode}
        spent = self._seconds() - before
        self._end()
        return {"hang": spent}

    def kill(self) -> None:
        """Ends the process, as a crash would."""
        if self._process is not None:
            self._process.kill()

    def _end(self) -> None:
        if self._process is not None:
            self.kill()
            self._process.communicate()
            self._process = None

    def _seconds(self) -> float:
        """Of the processor, so far."""
        assert self._process is not None
        try:
            words = Path(f"/proc/{self._process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            return 0.0
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main(*sys.argv[1:])
