"""How long Python takes to the first tracks."""

import subprocess
import sys
import time
from dataclasses import dataclass

from experiments.bench.many_logs import users_environment
from experiments.common import DEMO
from experiments.scoreboard.board import Figure, Promise

PROGRAM = """
import time
began = time.perf_counter()
import voodoo_jax as vj
recording = vj.read_log({log!r})
read = time.perf_counter()
tracks = vj.track(vj.human(), recording)
print(time.perf_counter() - began - tracks.seconds, tracks.compile_seconds)
"""


@dataclass(frozen=True)
class StartUp:
    """A new process tracks the demo: seconds that are not tracking, with programs compiled by an earlier process."""

    def run(self) -> float:
        words = [sys.executable, "-c", PROGRAM.format(log=str(DEMO / "demo.mcap"))]
        for _ in range(2):  # the first one compiles, if nobody has before
            out = subprocess.run(words, check=True, capture_output=True, text=True, env=users_environment()).stdout
        return float(out.split()[-2])


@dataclass(frozen=True)
class Help:
    """`voodoo-jax replay --help`, seconds."""

    def run(self) -> float:
        words = [sys.executable, "-m", "voodoo_jax.cli", "--help"]
        subprocess.run(words, check=True, capture_output=True, env=users_environment())
        began = time.perf_counter()
        subprocess.run(words, check=True, capture_output=True, env=users_environment())
        return time.perf_counter() - began


PROMISE = Promise(
    name="start_up",
    sentence="vj.track in a new process begins within 5 s where programs were compiled before.",
    data="the demo recording",
    figures=(
        Figure("vj.read_log and vj.track beside tracking, s", 5.0, digits=1),
        Figure("--help, s", 1.0),
    ),
    jobs=lambda data: [StartUp(), Help()],
    measure=lambda found: {"vj.read_log and vj.track beside tracking, s": found[0], "--help, s": found[1]},
    alone=True,
)
