"""Tracks of hard recordings, judged: how far off, and whether the tracker says so. Trials in two processes."""

import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Float32, Int64

from experiments.common import NEAR_NS, Log, Score, errors, human, load_dims, load_truth, nearest, off, score, scored
from voodoo_jax.compile.cache_dir import cache_folder, keep_compiled, use_compile_cache
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body import Body, segment_lengths
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.tracks import Tracks

Job = TypeVar("Job")
Out = TypeVar("Out")
ROOT_NEAR = 0.2  # metres: who claims to track has the pelvis at least so near


@dataclass(frozen=True)
class Recorded:
    """A recording in memory, all its points, and the truth."""

    name: str
    fixed_frame: str
    up: Float32[np.ndarray, "3"]
    frames: list[Frame]
    stamps: Int64[np.ndarray, " time"]  # nanoseconds
    names: tuple[str, ...]
    joints: Float[np.ndarray, "time joint 3"]  # metres
    there: Bool[
        np.ndarray, " time"
    ]  # False: the person is not, or not wholly, in view; not scored, must not be claimed
    dims: dict[str, float]  # stature and segments, metres

    def log(self, body: Body, settings: Settings) -> Log:
        """With the person told apart; the truth of the times in view and of frames that there are."""
        scene, people = find_body(self.frames, self.up, body, settings)
        joints = np.where(self.there[:, None, None], self.joints, np.nan)
        stamps = np.array([f.time_ns for f in self.frames], np.int64)
        first = int(np.argmax(self.there))
        kept = np.abs(stamps[None] - self.stamps[:, None]).min(1) < NEAR_NS
        kept[:first] = False
        return Log(
            self.name, self.name, self.fixed_frame, scene, people, self.stamps[kept], self.names, joints[kept]
        )  # fmt: skip


def read(path: Path, settings: Settings, frames: int = 0) -> Recorded:
    """A recording with its truth, the first `frames` frames (0: all)."""
    reader = open_log(path, settings.read)
    found = list(reader.frames())
    found = found[: frames or None]
    dims = load_dims(path)
    t = load_truth(path, found[-1].time_ns)
    there = np.ones(len(t.time_ns), bool)
    return Recorded(path.stem, reader.fixed_frame, reader.up, found, t.time_ns, t.names, t.joints, there, dims)


@cache
def whole(path: Path, frames: int = 0) -> Recorded:
    """A recording as it is, read once by each process."""
    return read(path, Settings(), frames)


@cache
def told_apart(path: Path, step: int = 1, frames: int = 0) -> tuple[Recorded, Log]:
    """A recording, every `step`-th of its frames, with the person told apart; the points of the room are not kept."""
    return segmented(path, Settings(), step, frames)


def segmented(path: Path, settings: Settings, step: int = 1, frames: int = 0) -> tuple[Recorded, Log]:
    """The same with other settings; read anew."""
    recorded = read(path, settings, frames)
    recorded = replace(recorded, frames=recorded.frames[::step])
    return replace(recorded, frames=[]), recorded.log(human(), settings)


@dataclass(frozen=True)
class Verdict:
    """How a trial went; shares in percent."""

    score: Score
    false_well: float  # of the scored frames: off, and said to be tracked
    tracked: float  # of the scored frames: said to be tracked
    honest: float  # of all frames said to be tracked: pelvis within 20 cm; NaN: none is
    stature_cm: float
    segments_cm: float
    steps: float  # per frame
    frames: int
    seconds: float  # of tracking, without compiling


def root_near(log: Log, tracks: Tracks) -> Bool[np.ndarray, " time"]:
    """At which times of the truth the middle of the hips is right in the nearest frame."""
    hips, mine = ([names.index(n) for n in ("l_hip", "r_hip")] for names in (log.names, tracks.body.topology.centres))
    found = tracks.joints[nearest(log, tracks)[0]][:, mine]
    return np.linalg.norm(found.mean(1) - log.joints[:, hips].mean(1), axis=1) < ROOT_NEAR


def judge(recorded: Recorded, log: Log, tracks: Tracks) -> Verdict:
    """Compares tracks with the truth by score.py's rules, and with what they claim."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # means of frames without any truth
        found, error = score(log, tracks), errors(log, tracks)
        count = scored(log) & np.isfinite(error).any(1)
        frame, near = nearest(log, tracks)
        claimed = tracks.tracked[frame] & near
        wrong = off(error, log.names)
    # of the whole truth, also while the person is out of view
    out_of_view_too = replace(log, stamps=recorded.stamps, joints=recorded.joints)
    frame, near = nearest(out_of_view_too, tracks)
    said = tracks.tracked[frame] & near
    honest = float(root_near(out_of_view_too, tracks)[said].mean()) if said.any() else float("nan")
    lengths = segment_lengths(tracks.body)
    segments = [abs(lengths[k] - v) for k, v in recorded.dims.items() if k in lengths]
    return Verdict(
        score=found,
        false_well=100 * float((claimed & wrong)[count].mean()),
        tracked=100 * float(claimed[count].mean()),
        honest=100 * honest,
        stature_cm=100 * abs(float(tracks.body.scale) - recorded.dims["stature"]),
        segments_cm=100 * float(np.mean(segments)) if segments else float("nan"),
        steps=float(tracks.evidence.steps.mean()),
        frames=len(tracks.time_ns),
        seconds=tracks.seconds,
    )


HEAD = ["mean joint error, cm", "within 10 cm, %", "lost / acceptable / good", "false-well, %"]
HONEST_HEAD = ["said to be tracked, %", "of these pelvis within 20 cm, %", "stature, cm"]


def mean_of(verdicts: list[Verdict], name: str) -> float:
    """Mean of one number over the trials that have it."""
    values = np.array([getattr(v, name) for v in verdicts])
    return float(values[np.isfinite(values)].mean()) if np.isfinite(values).any() else float("nan")


def cells(verdicts: list[Verdict]) -> list[str]:
    """What HEAD names."""
    scores = [v.score for v in verdicts]
    grades = " / ".join(str(sum(s.grade == g for s in scores)) for g in (0, 1, 2))
    error, within = (np.mean([getattr(s, name) for s in scores]) for name in ("error_cm", "within"))
    return [f"{error:.2f}", f"{within:.1f}", grades, f"{mean_of(verdicts, 'false_well'):.1f}"]


def honest_cells(verdicts: list[Verdict]) -> list[str]:
    """What HONEST_HEAD names; "-" where nothing was claimed."""
    found = [mean_of(verdicts, name) for name in ("tracked", "honest", "stature_cm")]
    return [f"{x:.{d}f}" if np.isfinite(x) else "-" for x, d in zip(found, (1, 1, 2))]


def trials(work: Callable[[Job], Out], jobs: list[Job], processes: int) -> Iterator[Out]:
    """Outcomes in the order of the jobs, as they come. `work` of an importable module; 1 process: this one."""
    if processes <= 1:
        yield from map(work, jobs)
        return
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        yield from pool.map(partial(sharing, work), jobs)


def sharing(work: Callable[[Job], Out], job: Job) -> Out:
    """Does a job with the programs that any process has compiled before."""
    use_compile_cache(cache_folder(""))
    outcome = work(job)
    keep_compiled()
    return outcome
