"""What a frame more costs in memory."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from experiments.common import DEMO
from experiments.scoreboard.board import Data, Figure, Promise
from voodoo_jax.detect.stage import WINDOW

# the demo there and back again and again, so that nobody jumps; results are kept as the command keeps them
PROGRAM = """
import threading, time
from dataclasses import replace
import numpy as np
import voodoo_jax as vj
peak = 0
def now():  # memory of its own: not pages of the file in which points wait, which the system may drop
    words = open("/proc/self/status").read().split()
    return int(words[words.index("RssAnon:") + 1])
def watch():
    global peak
    while True:
        peak = max(peak, now())
        time.sleep(0.05)
threading.Thread(target=watch, daemon=True).start()
frames = list(vj.read_log({log!r}).frames)
recording = vj.read_log({log!r})
step = int(np.median(np.diff([f.time_ns for f in frames])))
def played():
    for k in range({count}):
        turn, at = divmod(k, len(frames))
        yield replace(frames[at if turn % 2 == 0 else -1 - at], time_ns=frames[0].time_ns + k * step)
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.of_points import track_person
scene, people = find_body(played(), recording.up, vj.human(), vj.Settings())
tracks = track_person(Task(vj.human(), LogInfo("", recording.fixed_frame), vj.Settings()), scene, people)
assert tracks.tracked.mean() > 0.9
print(peak, now())
"""


class Used(NamedTuple):
    """What a process needed."""

    frames: int
    peak: float  # largest resident memory of its own (without pages of files), bytes
    last: float  # when all was done, with the results


@dataclass(frozen=True)
class TrackFrames:
    """A process of its own tracks so many frames."""

    frames: int

    def run(self) -> Used:
        program = PROGRAM.format(log=str(DEMO / "demo.mcap"), count=self.frames)
        out = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
        peak, last = (1024 * float(word) for word in out.split()[-2:])
        return Used(self.frames, peak, last)


def jobs(data: Data) -> list[TrackFrames]:
    """Two lengths, both of whole windows in which furniture is told from the body, and of whole spans, which are
    tracked back before the next one begins: what is held of these meanwhile is the same. None when quick."""
    return (
        []
        if data.quick or not Path("/proc/self/status").exists()
        else [TrackFrames(2 * WINDOW), TrackFrames(6 * WINDOW)]
    )


def measure(found: list[Used]) -> dict[str, float]:
    """Growth from the short to the long recording: of the peak or, if that is more, of what is there at the end, which
    makes the peak of a recording of hours."""
    short, long = found
    growth = max(long.peak - short.peak, long.last - short.last) / (long.frames - short.frames)
    return {"memory, kB a frame": growth / 1e3, "memory of the short one, GB": short.peak / 1e9}


PROMISE = Promise(
    name="memory",
    sentence="An hour of log needs little more memory than its results (3.8 kB a frame).",
    data="the demo, played there and back again and again (on Linux)",
    figures=(Figure("memory, kB a frame", 6.0, digits=1), Figure("memory of the short one, GB", 1.3)),
    jobs=jobs,
    measure=measure,
    alone=True,
)
