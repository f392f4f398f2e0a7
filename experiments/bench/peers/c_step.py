"""The step in C (step.c), compiled on the spot: what one core of this machine can do, within reason."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from experiments.bench.peers.numpy_step import Pose
from experiments.bench.work import LEAST, RATIO, REACH, STEPS, Work

FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC")


@cache
def _library() -> ctypes.CDLL:
    if shutil.which("gcc") is None:
        raise ImportError("gcc is not installed")
    folder = Path(tempfile.mkdtemp(prefix="step-"))
    try:
        source = Path(__file__).with_name("step.c")
        subprocess.run(["gcc", *FLAGS, "-c", str(source), "-o", str(folder / "step.o")], check=True)
        # linked without -ffast-math, which would switch denormal numbers off in the whole process
        subprocess.run(["gcc", "-shared", str(folder / "step.o"), "-o", str(folder / "step.so"), "-lm"], check=True)
        return ctypes.CDLL(str(folder / "step.so"))
    finally:
        shutil.rmtree(folder)  # the loaded library stays


def build(work: Work, points: int) -> Callable[[], Pose]:
    """All frames, one after the other; poses after the last."""
    library = _library()
    frames, weight = work.frames(points), np.ascontiguousarray(work.band_weight, np.float32)
    given = [np.ascontiguousarray(a) for a in (work.parent, work.child, work.pa, work.pc, weight)]
    size = np.ascontiguousarray(work.size)
    at = lambda a: ctypes.c_void_p(a.ctypes.data)  # noqa: E731

    def run() -> Pose:
        R, t = work.R.copy(), work.t.copy()
        library.frames(
            at(size), at(R), at(t), len(size), *(at(a) for a in given), len(weight), at(frames), points, len(frames),
            STEPS, ctypes.c_float(REACH), ctypes.c_float(RATIO), ctypes.c_float(LEAST),
        )  # fmt: skip
        return R, t

    return run
