"""What the experiments share: recordings with their truth, tracking them, scores and grades, files."""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from tqdm import tqdm

from experiments.bench.replay_speed import Started
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.fitting.frames import Truth, read_truth
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body import Body
from voodoo_jax.model.body_file import load_body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Pairs, Rays
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.stretches import stretches
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.of_points import track_person

DEMO = Path(__file__).parents[1] / "voodoo_jax" / "data"  # the recording that the package brings along
SKIP = 0.5  # seconds of the truth's beginning that are not scored: the tracker finds the body there
NEAR_NS = 17_000_000  # half a frame at 30 Hz: farther away is the stamp of another frame
GROUPS = {
    "head": ("skullbase",),
    "trunk": ("vc7", "l_shoulder", "r_shoulder", "l_hip", "r_hip"),
    "elbows": ("l_elbow", "r_elbow"),
    "wrists": ("l_radiocarpal", "r_radiocarpal"),
    "knees": ("l_knee", "r_knee"),
    "ankles": ("l_talocrural", "r_talocrural"),
}
LIMBS = (
    ("skullbase",),
    *((f"{side}_{upper}", f"{side}_{lower}")
      for upper, lower in (("elbow", "radiocarpal"), ("knee", "talocrural")) for side in "lr"),
)  # fmt: skip


class Compared(Protocol):
    """What tracks are compared with: a truth by itself, or a log that has one."""

    @property
    def stamps(self) -> np.ndarray: ...  # [time] nanoseconds
    @property
    def names(self) -> tuple[str, ...]: ...  # joint names, as bodies call them
    @property
    def joints(self) -> np.ndarray: ...  # [time, joint, 3] metres, fixed frame; NaN: no truth


@dataclass(frozen=True)
class Log:
    """A recording in which the person is already told apart, and the truth."""

    name: str
    path: str
    fixed_frame: str
    scene: Scene
    people: list[BodyObservation]
    stamps: np.ndarray  # [time] of the truth, nanoseconds
    names: tuple[str, ...]  # joint names of the truth, as bodies call them
    joints: np.ndarray  # [time, joint, 3] metres, fixed frame; NaN: no truth

    def track(self, body: Body, settings: Settings, people: list[BodyObservation] | None = None) -> Tracks:
        """Tracks the person, or other frames of it."""
        people = self.people if people is None else people
        return track_person(Task(body, LogInfo(self.path, self.fixed_frame), settings), self.scene, people)


def log_files(recordings: Path) -> list[Path]:
    """The recordings of a folder that have a truth."""
    files = sorted(p for p in recordings.glob("*.mcap") if p.with_suffix(".truth.npz").exists())
    if not files:
        raise SystemExit(f"{recordings}: no *.mcap with a *.truth.npz beside it")
    return files


def pick(recordings: Path, name: str) -> Path:
    """The recording of that name in a folder, or the first."""
    files = log_files(recordings)
    return next((p for p in files if p.stem == name), files[0])


def load_logs(recordings: Path, body: Body, settings: Settings, every: int = 1, frames: int = 0) -> list[Log]:
    """Every `every`-th recording of a folder, the first `frames` frames (0: all) of each."""
    files = log_files(recordings)[::every]
    return [load_log(p, body, settings, frames) for p in tqdm(files, "read", unit="log", leave=False, disable=None)]


def halves(files: list[Path]) -> tuple[list[Path], list[Path]]:
    """The recordings of every other person, and those of the others; people in the order of their statures."""
    stature = {file: round(load_dims(file)["stature"], 3) for file in files}
    people = sorted(set(stature.values()))
    first, second = ([f for f in files if people.index(stature[f]) % 2 == k] for k in (0, 1))
    return first, second


def load_log(path: Path, body: Body, settings: Settings, frames: int = 0) -> Log:
    """One recording, its first `frames` frames (0: all)."""
    reader = open_log(path, settings.read)
    scene, people = find_body(islice(reader.frames(), frames or None), reader.up, body, settings)
    truth = load_truth(path, people[-1].time_ns if frames else None)
    return Log(
        path.stem, reader.path, reader.fixed_frame, scene, people, truth.time_ns, truth.names, truth.joints
    )  # fmt: skip


def load_truth(path: Path, last_ns: int | None = None) -> Truth:
    """The truth of a recording, up to a time."""
    truth = read_truth(path.with_suffix(".truth.npz"))
    seen = slice(None) if last_ns is None else truth.time_ns <= last_ns
    return truth._replace(time_ns=truth.time_ns[seen], joints=truth.joints[seen])


def without_features(people: list[BodyObservation]) -> list[BodyObservation]:
    """The frames as `--read.no-features` gives them."""
    return [replace(f, rays=Rays(), pairs=Pairs()) for f in people]


def load_dims(path: Path) -> dict[str, float]:
    """Stature and segment lengths in the truth of a recording, metres."""
    with np.load(path.with_suffix(".truth.npz"), allow_pickle=False) as truth:
        return json.loads(str(truth["dims"]))


@dataclass(frozen=True)
class Score:
    """How far tracks are from the truth."""

    error_cm: float  # mean over frames and joints; what has no answer counts 100
    within: float  # share of joints within 10 cm, percent
    grade: int  # 0 lost, 1 acceptable, 2 good: the classes of the 2006 paper's Table I, made a rule
    joints_cm: dict[str, float]  # mean by joint

    def group(self, name: str) -> float:
        """Mean error of a group of joints, cm."""
        return float(np.mean([self.joints_cm[j] for j in GROUPS[name] if j in self.joints_cm]))


def score(log: Log, tracks: Tracks) -> Score:
    """Compares tracks with a recording's truth, but for its first half second."""
    error = errors(log, tracks)[scored(log)]
    known = error[np.isfinite(error)]
    rate = 1e9 / float(np.median(np.diff(log.stamps)))
    joints = {n: 100 * float(e) for n, e in zip(log.names, np.nanmean(error, 0))}
    return Score(100 * float(known.mean()), 100 * float((known < 0.1).mean()), grade(error, log.names, rate), joints)


def scored(log: Compared) -> np.ndarray:
    """[time] Which times of the truth are scored."""
    return log.stamps >= log.stamps[0] + int(SKIP * 1e9)


def nearest(log: Compared, tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """[time] The tracks' frame nearest to each time of the truth, and whether it is near enough to be that frame."""
    found = np.abs(tracks.time_ns[None] - log.stamps[:, None]).argmin(1)
    return found, np.abs(tracks.time_ns[found] - log.stamps) < NEAR_NS


def errors(log: Compared, tracks: Tracks) -> np.ndarray:
    """[time, joint] Distances from the truth, metres: 1 where there is no answer, NaN where there is no truth."""
    frame, near = nearest(log, tracks)
    found = tracks.joints[frame][:, [tracks.body.topology.centres.index(n) for n in log.names]].astype(float)
    found[~near] = np.nan
    error = np.linalg.norm(found - log.joints, axis=-1)
    error = np.where(np.isfinite(error), error, 1.0)
    error[~np.isfinite(log.joints).all(-1)] = np.nan
    return error


def off(error: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """[time] Where the trunk or two limbs are more than 20 cm off."""
    far = [_mean_of(error, names, limb) > 0.2 for limb in LIMBS if set(limb) <= set(names)]
    return (_mean_of(error, names, GROUPS["trunk"]) > 0.2) | (np.sum(far, 0) >= 2)


def _mean_of(error: np.ndarray, names: tuple[str, ...], group: tuple[str, ...]) -> np.ndarray:
    """[time] Mean over the joints of a group with a truth; NaN where there is none."""
    some = error[:, [names.index(n) for n in group if n in names]]
    known = np.isfinite(some)
    total, count = np.where(known, some, 0).sum(1), known.sum(1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def grade(error: np.ndarray, names: tuple[str, ...], rate: float) -> int:
    """0: trunk or two limbs over 20 cm off for over 1 s or at the end; 1: a joint over 15 cm off for over 0.5 s."""
    bad = off(error, names)
    if longest(bad) > rate or bad[-max(1, int(0.3 * rate)) :].all():
        return 0
    return 1 if any(longest(joint > 0.15) > 0.5 * rate for joint in error.T) else 2


def longest(mask: np.ndarray) -> int:
    """Length of the longest run of True."""
    return max((end - begin for begin, end in stretches(np.asarray(mask, bool))), default=0)


def sweep(logs: list[Log], body: Body, variants: dict[tuple, Settings]) -> dict[tuple, list[Score]]:
    """Scores of every variant of the settings on every log."""
    results: dict[tuple, list[Score]] = {key: [] for key in variants}
    with tqdm(total=len(variants) * len(logs), unit="log", leave=False, disable=None) as bar:
        for key, settings in variants.items():
            for log in logs:
                bar.set_description(" ".join(map(str, key)))
                results[key].append(score(log, log.track(body, settings)))
                bar.update(1)
            # at once: a long sweep may be stopped
            tqdm.write(" ".join([*map(str, key), "|", *mean_row(results[key])]))
    return results


def mean_row(scores: list[Score]) -> list[str]:
    """Mean error, share within 10 cm and lost / acceptable / good of some logs, as cells (see MEAN_HEAD)."""
    grades = [sum(s.grade == g for s in scores) for g in (0, 1, 2)]
    error, within = (float(np.mean([getattr(s, name) for s in scores])) for name in ("error_cm", "within"))
    wrists = float(np.mean([s.group("wrists") for s in scores]))
    return [f"{error:.2f}", f"{wrists:.2f}", f"{within:.1f}", " / ".join(map(str, grades))]


MEAN_HEAD = ["mean joint error, cm", "wrists, cm", "within 10 cm, %", "lost / acceptable / good"]


def table(head: list[str], rows: list[list[str]], left: int = 1) -> str:
    """Markdown; the first `left` columns are text, the others numbers."""
    lines = [head, ["---" if i < left else "---:" for i in range(len(head))], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def write(out: Path, name: str, text: str, figure: Figure | None = None, dpi: int = 100) -> None:
    """Prints a table and writes it as out/name.md, and a figure as out/name.png."""
    out.mkdir(parents=True, exist_ok=True)
    print(text)
    (out / f"{name}.md").write_text(text)
    if figure is not None:
        drawn = BytesIO()
        figure.savefig(drawn, format="png", dpi=dpi)
        plt.close(figure)
        # a palette: a third of the size; by coverage, else colours of few pixels are lost
        small = Image.open(drawn).convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        small.save(out / f"{name}.png", optimize=True)
    print(f"written: {out / name}.md" + (f", {out / name}.png" if figure is not None else ""))


def started(log: Log, body: Body, settings: Settings) -> Started:
    """The recording tracked as it is, from the first tracked frame on: what the timings start from."""
    first = int(np.argmax(log.track(body, settings).tracked))
    tracks = log.track(body, settings, log.people[first:])
    if not tracks.tracked[0]:
        raise SystemExit(f"{log.path}: nobody was tracked in it, there is nothing to measure")
    return Started(tracks, log.people[first:], 0.0)


def rounds(contenders: dict[tuple, Callable[[], float]], count: int) -> dict[tuple, float]:
    """Median seconds of each contender, run in turns after one warm run each: a busy machine hits all alike."""
    times: dict[tuple, list[float]] = {key: [] for key in contenders}
    for turn in tqdm(range(count + 1), "rounds", leave=False, disable=None):
        for key, run in contenders.items():
            seconds = run()
            if turn:
                times[key].append(seconds)
    return {key: float(np.median(t)) for key, t in times.items()}


def machine_line(before: dict) -> str:
    """What timings were taken on, with the load before and after."""
    words = ", ".join(f"{k} {v}" for k, v in before.items() if k != "load_1min")
    return f"Taken on: {words}; load average {before['load_1min']} before, {round(os.getloadavg()[0], 2)} after.\n"


def slow_noise(rng: np.random.Generator, count: int, over: float, reach: int) -> np.ndarray:
    """Normal noise of deviation 1 that changes over so many samples, each drawn from `reach` to both sides."""
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / over) ** 2)
    return np.convolve(rng.standard_normal(count + 2 * reach), kernel / np.linalg.norm(kernel), "valid")


def line_fit(x: list[float], y: list[float]) -> tuple[float, float, float]:
    """Slope, intercept and R^2 of the straight line through points."""
    slope, intercept = np.polyfit(x, y, 1)
    rest = np.asarray(y) - (slope * np.asarray(x) + intercept)
    return float(slope), float(intercept), 1 - float(np.sum(rest**2) / np.sum((np.asarray(y) - np.mean(y)) ** 2))


def settings_with(options: dict[str, Any]) -> Settings:
    """The default settings with some options, "stage.option", changed."""
    settings = Settings()
    for name, value in options.items():
        stage, option = name.split(".")
        settings = replace(settings, **{stage: replace(getattr(settings, stage), **{option: value})})
    return settings


def human() -> Body:
    """The body that the experiments track unless they say otherwise."""
    return load_body("human")
