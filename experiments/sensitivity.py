"""What do the finder's numbers and mechanisms change? python -m experiments.sensitivity LOG.mcap ...

Each mechanism is switched off, and each number of `detect` that was set by hand is made 1.5 times as large and as
small, one at a time; then people are looked for again in all logs. Tracks follow from the points and the scene that are
found: where these are the same bit by bit, nothing is tracked. Prints a row for each change.
"""

import ast
import hashlib
import importlib
import pickle
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from itertools import product
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import tyro
from jaxtyping import Float, Float32, Int64
from scipy.spatial import KDTree

from experiments.common import human
from experiments.stress.scenes import scenes, shoot
from voodoo_jax.config.options import Settings
from voodoo_jax.detect import (
    body_likelihood,
    camera_motion,
    clearing,
    cut_in_two,
    drop_seen_apart,
    drop_wide_still,
    motion,
    pipeline,
    raise_floor,
    scene,
    segmentation,
    stillness,
    tracklets,
    weigh_by_noise,
)
from voodoo_jax.detect.opening import open_checked
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Subject

PACKAGE = Path(pipeline.__file__).parent
FACTORS = 1.5, 1 / 1.5
REACHED, STRAY = 0.15, 0.35  # metres from a joint: points show it; and no point on a body is so far from all of them
NEAR_NS = 17_000_000


@dataclass(frozen=True)
class Log:
    """A recording in memory, and its truth."""

    name: str
    frames: list[Frame]
    up: Float32[np.ndarray, "3"]
    stamps: Int64[np.ndarray, " time"]  # of the truth, nanoseconds; none: there is no truth
    joints: Float[np.ndarray, "time joint 3"]  # metres, of all people together; NaN: not there


class Outcome(NamedTuple):
    """What was found in a log."""

    digest: str  # of all that the trackers are given
    reached: float  # share of the truth's joints that are near points; NaN without a truth
    stray: float  # share of the points that are far from the truth's joints
    people: int  # with points


def read(path: Path, step: int, seconds: float) -> Log:
    """Every `step`-th frame of the first seconds of a log."""
    reader = open_checked(path)
    frames: list[Frame] = []
    for k, frame in enumerate(reader.frames()):
        if frames and frame.time_ns - frames[0].time_ns > seconds * 1e9:
            break
        if k % step == 0:
            frames.append(replace(frame, pictures=()))
    stamps, joints = np.zeros(0, np.int64), np.zeros((0, 0, 3))
    if (truth := path.with_suffix(".truth.npz")).exists():
        with np.load(truth, allow_pickle=False) as file:
            stamps, joints = file["time_ns"].astype(np.int64), file["joints"].astype(float)
        joints = np.concatenate(list(joints), 1) if joints.ndim == 4 else joints
    return Log("/".join(path.parts[-2:]), frames, reader.up, stamps, joints)


def simulated(name: str, seconds: float) -> Log:
    """The first seconds of a scene of experiments/stress."""
    one = shoot(name, scenes()[name](), round(seconds * 30))
    return Log(f"scene: {name}", one.frames, one.up, one.stamps, np.where(one.there[:, None, None], one.joints, np.nan))


def look(log: Log, body: Body, settings: Settings) -> Outcome:
    """Looks for all people in a log."""
    people = pipeline.find_people(log.frames, log.up, body, settings)
    digest = hashlib.sha256()
    for one in people:
        planes = (one.scene.floor, *one.scene.walls)
        digest.update(repr([(p.normal, p.offset) for p in planes] + [one.scene.floor_seen]).encode())
        for frame in one.frames:
            said = (frame.points, frame.sensor, frame.weight, frame.before, frame.T_fixed_steady)
            digest.update(b"".join(np.ascontiguousarray(a).tobytes() for a in said if a is not None))
            digest.update(repr((frame.noise, frame.doubt, frame.other)).encode())
    return Outcome(digest.hexdigest(), *_judged(log, people), sum(any(len(f.points) for f in p.frames) for p in people))


def _judged(log: Log, people: list[Subject]) -> tuple[float, float]:
    reached, stray = [], []
    for frames in zip(*(one.frames for one in people)):
        off = np.abs(log.stamps - frames[0].time_ns)
        if not len(off) or off.min() > NEAR_NS:
            continue
        points, joints = np.concatenate([f.points for f in frames]), log.joints[int(off.argmin())]
        joints = joints[np.isfinite(joints).all(1)]
        if len(joints):
            far = KDTree(points).query(joints)[0] if len(points) else np.full(len(joints), np.inf)
            reached.append(float(np.mean(far < REACHED)))
        if len(points):
            stray.append(float(np.mean(KDTree(joints).query(points)[0] > STRAY)) if len(joints) else 1.0)
    return float(np.mean(reached)) if reached else np.nan, float(np.mean(stray)) if stray else np.nan


@contextmanager
def changed(owner: Any, name: str, value: Any) -> Iterator[None]:
    """With another value of a number of a module, also where it was imported to and in the defaults of the module's
    functions, or of a stage."""
    old = getattr(owner, name)
    if not isinstance(owner, ModuleType):
        object.__setattr__(owner, name, value)  # stages are frozen
        yield
        object.__setattr__(owner, name, old)
        return
    modules = [m for key, m in sys.modules.items() if key.startswith("voodoo_jax.") and vars(m).get(name) is old]
    inside = [f for c in vars(owner).values() if isinstance(c, type) for f in vars(c).values()]
    functions = [f for f in (*vars(owner).values(), *inside) if isinstance(f, FunctionType)]
    defaults = {f: f.__defaults__ for f in functions if any(d is old for d in f.__defaults__ or ())}
    for module in modules:
        setattr(module, name, value)
    for f, given in defaults.items():
        f.__defaults__ = tuple(value if d is old else d for d in given or ())
    yield
    for module in modules:
        setattr(module, name, old)
    for f, given in defaults.items():
        f.__defaults__ = given


Change = Callable[[], Any]  # gives a context in which something is otherwise
Off = dict[str, tuple[Any, str, Any]]  # by mechanism: what has it, as what, and what stands in its place


def numbers(files: str, sources: str = "by hand") -> dict[str, Change]:
    """Each number of the files of `detect` beside which these words stand, and of their stages, times and over 1.5."""
    found: dict[str, Change] = {}

    def add(label: str, owner: Any, name: str) -> None:
        value = getattr(owner, name)
        every = value if isinstance(value, tuple) else (value,)
        for at, factor in product(range(len(every)), FACTORS):
            one = every[at]
            if not isinstance(one, int | float):
                continue
            other = max(round(one * factor), 1) if isinstance(one, int) else one * factor
            new = (*every[:at], other, *every[at + 1 :]) if isinstance(value, tuple) else other
            found[f"{label}.{name}[{at}] {one:g} -> {other:g}"] = lambda new=new: changed(owner, name, new)

    for path in sorted(PACKAGE.glob(files)):
        module = importlib.import_module(f"voodoo_jax.detect.{path.stem}")
        for name in _marked(path, sources):
            add(path.stem, module, name)
        for one in (*pipeline.POINTS, motion.ASKS):
            for name in vars(one) if one.name == path.stem else ():
                add("ASKS" if one is motion.ASKS else one.name, one, name)
    return found


def _marked(path: Path, sources: str) -> list[str]:
    """Names of a file's numbers beside which, or above which, these words stand."""
    lines, found = path.read_text().splitlines(), list[str]()
    for node in ast.parse("\n".join(lines)).body:
        if not isinstance(node, ast.Assign) or not isinstance(
            node.value, ast.Constant | ast.Tuple | ast.BinOp | ast.UnaryOp
        ):
            continue
        at = node.lineno - 1
        while lines[at - 1].startswith("#"):
            at -= 1
        target = node.targets[0]
        if sources in " ".join(lines[at : node.end_lineno]):
            found += [ast.unparse(one) for one in (target.elts if isinstance(target, ast.Tuple) else [target])]
    return found


class _Nothing:
    """In place of a count of what was seen where."""

    def __init__(self, owner: Any):
        self.add = self.clear = lambda *given: None
        self.cells = lambda least: np.zeros((0, 3), np.int64)


def _near_alone(self: Any, points: Any, label: Any, counts: Any, last: Any) -> np.ndarray:
    """Which objects are near the body's last place, whatever stood apart from it before."""
    return counts[1] > np.maximum(np.clip(segmentation.FEW * len(last), *segmentation.SPECK), 0.3 * counts[0])


def _nowhere(self: Any, points: Any, label: Any, count: Any, *given: Any) -> np.ndarray:
    """None of the objects."""
    return np.zeros(len(count), bool)


def _not_back(self: Any, finder: Any, seen: Any) -> Any:
    """A new tracklet from this frame on."""
    one = tracklets.Tracklet(finder, self._number)
    one.motion.note(seen, self._recent[-1][0], False, finder.scene.floor if finder.lies else None)
    one.add(seen, self._number)
    return one


def mechanisms() -> Off:
    """Each with what it is replaced by."""
    off: Off = {}
    for place in ("SCENE", "POINTS"):
        for one in getattr(pipeline, place):
            rest = tuple(s for s in getattr(pipeline, place) if s is not one)
            off[f"stage {one.name}"] = pipeline, place, rest
    none = np.zeros((0, 3), np.float32)
    finder, wide = segmentation.BodySegmenter, drop_wide_still.DropWideStill
    off |= {
        "scene: a slanted floor is found again": (scene, "SLANTED", -1.0),
        "scene: nothing right above a floor": (scene, "_open", lambda points, plane: True),
        "scene: a wall is as high as it is wide": (scene, "filled", lambda place, height: np.inf),
        "scene: walls": (scene, "_find_walls", lambda *given: []),
        "clearing: what is behind a wall is in another room": (clearing, "BEHIND", np.inf),
        "clearing: flying pixels": (clearing, "without_strays", lambda points, *given: np.ones(len(points), bool)),
        "clearing: links across a scanner's rows": (clearing, "DENSE", np.inf),
        "segments: a head belongs to what is below": (cut_in_two, "HEADS", np.inf),
        "segments: floor that nobody sees is below": (segmentation, "WHOLE", 0.0),
        "segments: people who touch": (segmentation, "each_person", lambda points, label, *given: label),
        "segments: cut in two": (segmentation, "joined", lambda seen, label, *given: label),
        "segments: counters": (body_likelihood, "SQUAT", 0.0),
        "segments: what hangs in the air": (body_likelihood, "PART", 0.0),
        "segments: broad at the top": (body_likelihood, "BROAD", np.inf),
        "segments: no poles": (body_likelihood, "SLIM", 1e-9),
        "segments: near ones": (body_likelihood, "NEAR", 1e9),
        "segments: lying people": (tracklets.Tracklets, "_lying", lambda *given: None),
        "segments: beds": (tracklets, "with_beds", lambda frame, scene, highest: [scene]),
        "segments: backs of sofas": (raise_floor, "_backs", lambda *given: []),
        "following: what was seen beside is background": (finder, "_learn", lambda *given: None),
        "following: what remains is background": (finder, "_left", property(_Nothing, lambda self, value: None)),
        "following: the whole room again and again": (finder, "surveys", lambda self, time_ns: False),
        "following: what comes near stays apart": (finder, "_followed", _near_alone),
        "following: a low thing that is left": (finder, "_is_left", lambda *given: False),
        "following: a head that was seen apart": (finder, "_is_head", lambda *given: False),
        "following: somewhere else after a moment": (finder, "_elsewhere", _nowhere),
        "following: a low thing counts less": (segmentation, "LOW", 1.0),
        "following: suddenly much lower": (finder, "_gone", lambda *given: False),
        "following: thinned": (finder, "_thin", lambda *given: None),
        "following: where nothing was found": (finder, "passed", property(lambda self: none, lambda self, value: None)),
        "following: points in the way": (segmentation, "in_the_way", lambda *given: (none, np.zeros(0, np.int8))),
        "tracklets: hidden places": (tracklets.Tracklet, "keep_hidden", lambda *given: None),
        "tracklets: walking on behind somebody": (tracklets.Tracklet, "_velocity", lambda self: np.zeros(3, "f4")),
        "tracklets: idle ones end": (tracklets, "IDLE_NS", 1 << 62),
        "tracklets: points nearest to": (tracklets, "_owners", lambda seen, *g: np.full(len(seen.points), -1, np.int8)),
        "tracklets: a child beside an adult": (tracklets, "LIKELY", 0.0),
        "tracklets: low ones that move": (tracklets, "LOW", 9.0),
        "tracklets: back to the appearance": (tracklets.Tracklets, "_found", _not_back),
        "tracklets: people who come back": (tracklets, "_unlike", lambda *given: np.inf),
        "tracklets: thinned": (tracklets.Tracklets, "_thin", lambda *given: None),
        "motion: an arm that moves": (motion.Sight, "newly_in", lambda self, before: 0.0),
        "motion: swaying": (motion, "SWAYING", np.inf),
        "motion: far away at once": (motion, "AWAY", np.inf),
        "motion: dogs and carts": (motion, "SLID", np.inf),
        "motion: flicker": (motion, "FLICKER", 0.0),
        "motion: arms hang before the trunk": (motion, "LEFT", 1e9),
        "motion: shaken sensors": (motion, "SHAKEN", motion.MOVED),
        "motion: sensors that go round": (motion, "WENT", np.inf),
        "stillness: edges": (stillness, "_as_usual", lambda count: count > 0),
        "stillness: filled": (motion, "filled", lambda found: np.ones(len(found.ratio), bool)),
        "noise: far sides": (weigh_by_noise, "has_far_sides", lambda frames: False),
        "wide: fronts": (wide, "_behind_front", lambda self, level, *g: np.zeros(len(level), bool)),
        "wide: tops": (wide, "_tops", lambda *given: []),
        "wide: things beside": (finder, "beside", lambda self: none),
        "apart: what remains": (drop_seen_apart, "_remains", lambda points, *given: np.zeros(len(points), bool)),
        "planes: found anew in steady frames": (camera_motion, "TIMES", 0),
    }  # fmt: skip
    return off


def same(one: Any, other: Any) -> bool:
    """Whether two results are equal bit by bit; False where they cannot be compared."""
    try:
        return pickle.dumps(one) == pickle.dumps(other)
    except (TypeError, AttributeError, pickle.PicklingError):
        return False


@contextmanager
def watched(off: Off, acts: set[str]) -> Iterator[None]:
    """Notes which of these functions give something else than what they would be replaced by; those that give nothing
    but change something, and numbers, always do."""
    put: list[tuple[Any, str, Any]] = []
    for label, (owner, name, instead) in off.items():
        real = vars(owner).get(name)
        if not isinstance(real, FunctionType):
            acts.add(label)
            continue

        def both(*given: Any, real: Any = real, instead: Any = instead, label: str = label, **named: Any) -> Any:
            found = real(*given, **named)
            if label not in acts and (found is None or not same(found, instead(*given, **named))):
                acts.add(label)
            return found

        put.append((owner, name, real))
        setattr(owner, name, both)
    try:
        yield
    finally:
        for owner, name, real in reversed(put):
            setattr(owner, name, real)


def row(name: str, looks: list[tuple[Log, Outcome, Outcome]], shown: int = 4) -> str:
    """What a change does."""
    looks = [one for one in looks if one[1].digest != one[2].digest]
    told = []
    for log, a, b in sorted(looks, key=lambda one: -abs(np.nan_to_num(one[2].reached - one[1].reached)))[:shown]:
        people = f", people {a.people} -> {b.people}" if a.people != b.people else ""
        reached, stray = (f"{100 * x:.1f} -> {100 * y:.1f}" for x, y in ((a.reached, b.reached), (a.stray, b.stray)))
        told.append(f"{log.name} ({reached}, stray {stray}{people})")
    return f"{len(looks)} | {name} | {'; '.join(told)}"


def main(
    logs: tyro.conf.Positional[tuple[Path, ...]] = (),
    only: tuple[str, ...] = ("*",),
    files: str = "",
    sources: str = "by hand",
    scene: tuple[str, ...] = (),
    step: int = 3,
    seconds: float = 4.0,
    enough: int = 4,
    kept: Path | None = None,
) -> None:
    """What the finder's mechanisms and numbers change.

    Args:
        logs: recordings.
        only: names of the mechanisms, with * and ?.
        files: names of files of `detect`, with * and ?, whose numbers are changed.
        sources: of the numbers beside which this stands; empty: of all.
        scene: names of scenes of experiments/stress, with * and ?.
        step: every so manieth frame is taken.
        seconds: of each log.
        enough: so many logs that a change alters are enough; 0: all are looked at.
        kept: file that keeps logs between runs.
    """
    body, settings = human(), Settings()
    if kept is not None and kept.exists():
        every = pickle.loads(kept.read_bytes())
    else:
        every = [read(path, step, seconds) for path in logs]
        every += [simulated(n, seconds) for n in scenes() if any(fnmatch(n, pattern) for pattern in scene)]
        if kept is not None:
            kept.write_bytes(pickle.dumps(every))
    off = {name: what for name, what in mechanisms().items() if any(fnmatch(name, pattern) for pattern in only)}
    before, acts, began = list[Outcome](), list[set[str]](), time.process_time()
    warnings.simplefilter("ignore", RuntimeWarning)
    for log in every:
        acts.append(set())
        with watched(off, acts[-1]):
            before.append(look(log, body, settings))
    print(f"{len(every)} logs, {sum(len(log.frames) for log in every)} frames, {time.process_time() - began:.1f} s")
    changes = {name: lambda what=what: patch.object(*what, create=True) for name, what in off.items()}
    changes |= numbers(files, sources) if files else {}
    for name, change in changes.items():
        looks = []
        for log, base, acting in zip(every, before, acts):
            if name in off and name not in acting or 0 < enough <= sum(a.digest != b.digest for _, a, b in looks):
                continue
            with change():
                looks.append((log, base, look(log, body, settings)))
        print(row(name, looks), flush=True)


if __name__ == "__main__":
    tyro.cli(main)
