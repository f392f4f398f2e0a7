"""Cases from the field: small logs as people elsewhere have them, each made, tracked and judged by its checks.

The folder of cases beside the recordings holds them: `<case>/make.py` writes the case's logs to the current folder.
What is right for each is in CASES, after the README there.
"""

import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import voodoo_jax as vj
from experiments.scoreboard.tracked import Known, Outcome, compared, read_known

TIMEOUT = 900.0  # seconds, by which a script that hangs is told from a busy machine: the longest works for some 20
SAME_FRAME = 17_000_000  # nanoseconds: half a frame at 30 Hz
HONEST = 0.15  # the mean confidence of joints may be above the share within 10 cm by so much
UPPER = ("skullbase", "vc7", *(f"{side}_{name}" for side in "lr" for name in ("shoulder", "elbow", "radiocarpal")))
LEGS = tuple(f"{side}_{name}" for side in "lr" for name in ("hip", "knee", "talocrural"))
MARKED = "markers/markers-movement"  # the recording of which the cases with markers are made


class Found(NamedTuple):
    """What came of a log, or of a folder."""

    people: tuple[vj.Tracks, ...]
    notes: tuple[str, ...]
    refused: str  # the sentence by which it was refused; empty: it was read
    results: int = 1  # how many recordings it was taken for


@dataclass(frozen=True)
class Place:
    """Where a case is made, and where the recordings are that it was made of."""

    made: Path
    recordings: Path
    found: dict[tuple[str, int], Found] = field(default_factory=dict)  # by log: each is tracked once

    def track(self, log: str, frames: int = 0) -> Found:
        """Tracks a log's first `frames` frames (0: all), or a folder as one recording."""
        if (log, frames) not in self.found:
            path = self.made / log
            self.found[log, frames] = folder_found(path) if path.is_dir() else log_found(path, frames)
        return self.found[log, frames]

    def known(self, truth: str) -> Known:
        """A truth: of a recording, by its name, or one that the case has made."""
        return read_known(self.made / truth if truth.endswith(".npz") else self.recordings / f"{truth}.truth.npz")


def log_found(path: Path, frames: int) -> Found:
    """Reads a log and tracks who is in it."""
    try:
        recording = vj.read_log(path)
    except vj.LogError as error:
        return Found((), (), unnamed(str(error), path))
    if frames:
        recording = replace(recording, frames=recording.frames[:frames])
    people = vj.track_people(vj.human(), recording)
    return Found(tuple(people), people[0].notes, "")


def folder_found(path: Path) -> Found:
    """Replays a folder as `voodoo-jax replay` does."""
    with tempfile.TemporaryDirectory() as out:
        outcomes = vj.replay_logs([path], out, quiet=True)
        people = tuple(vj.read_tracks(Path(out) / one.npz) for one in outcomes if one.npz)
    refused = " ".join(one.error for one in outcomes if one.error)
    return Found(people, tuple(note for one in outcomes for note in one.notes), refused, len(outcomes))


def unnamed(sentence: str, path: Path) -> str:
    """A sentence without the path of the log, whose words are not the sentence's."""
    return sentence.replace(str(path), "the log").replace(path.name, "the log")


class Check:
    """Something that is to be true of a case."""

    def wrong(self, place: Place) -> str:
        """What is wrong; empty: nothing is."""
        raise NotImplementedError

    def known(self, place: Place) -> dict[tuple[str, int], list[Known]]:
        """Truths by log, as Place.found names it, of the people who are in it."""
        return {}


@dataclass(frozen=True)
class Near(Check):
    """Somebody is tracked within a limit."""

    log: str
    truth: str  # name of a recording, or of a file that the case makes
    limit: float  # cm, mean over joints and frames that are tracked
    joints: tuple[str, ...] = ()  # of these joints; none named: all that the truth has
    doubtful: tuple[str, ...] = ()  # joints of which no more is to be said than is right
    tracked: float = 0.9  # share of the frames, but for the first half second, that are to be tracked at least
    at_most: float = 1.0  # and at most: the others have no data
    frames: int = 0  # frames that the result is to have; 0: any number
    first: int = 0  # so many frames are tracked alone, and the others only if these have enough people
    people: int = 1  # who are to be tracked in it, at least
    frame: str = ""  # in this fixed frame the truth lies at ...
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)  # ... metres
    notes: int | None = None  # so many notes there may be at most
    never: str = ""  # words that no note may have

    def wrong(self, place: Place) -> str:
        found = place.track(self.log, self.first)
        if self.first and len(found.people) >= self.people:
            found = place.track(self.log)
        if found.refused:
            return f"{self.log} refused: {found.refused[:80]} ..."
        if found.results != 1:
            return f"{self.log} is taken for {found.results} recordings"
        if len(found.people) < self.people:
            return f"{self.log}: {len(found.people)} of {self.people} people"
        if self.never and any(self.never in note for note in found.notes):
            return f"{self.log}: a note says '{self.never}'"
        if self.notes is not None and len(found.notes) > self.notes:
            return f"{self.log}: {len(found.notes)} notes"
        said = [self._wrong(tracks, self._truth(tracks, place)) for tracks in found.people]
        return "" if "" in said else f"{self.log}: {' / '.join(said)}"

    def _truth(self, tracks: vj.Tracks, place: Place) -> Known:
        return self.placed(place.known(self.truth), tracks)

    def placed(self, known: Known, tracks: vj.Tracks) -> Known:
        """A truth in the frame that the tracks are given in."""
        moved = tracks.fixed_frame == self.frame
        return known._replace(joints=known.joints + self.at) if moved else known

    def _wrong(self, tracks: vj.Tracks, known: Known) -> str:
        if self.frames and len(tracks.time_ns) != self.frames:
            return f"{len(tracks.time_ns)} frames, not {self.frames}"
        outcome = beside(tracks, known)
        if outcome is None:
            return "no frame at a time of the truth"
        share = float(outcome.claimed.mean())
        if not self.tracked <= share <= self.at_most:
            return f"{100 * share:.0f} % tracked"
        use = [outcome.names.index(name) for name in self.joints] or list(range(len(outcome.names)))
        error = 100 * float(np.nanmean(outcome.error[outcome.claimed][:, use]))
        if not error <= self.limit:
            return f"{error:.1f} cm"
        legs = [outcome.names.index(name) for name in self.doubtful]
        right = np.mean(outcome.error[:, legs] < 0.1) if legs else math.inf
        said = np.mean(outcome.confidence[:, legs]) if legs else 0.0
        return f"hidden joints said right {100 * said:.0f} %, are {100 * right:.0f} %" if said > right + HONEST else ""

    def known(self, place: Place) -> dict[tuple[str, int], list[Known]]:
        key = (self.log, 0)
        found = place.found.get(key)
        return {key: [self._truth(found.people[0], place)]} if found is not None and found.people else {}


@dataclass(frozen=True)
class Nobody(Check):
    """Nothing is tracked, and nothing untrue is said."""

    log: str

    def wrong(self, place: Place) -> str:
        found = place.track(self.log)
        claimed = max((float(tracks.tracked.mean()) for tracks in found.people), default=0.0)
        return f"{self.log}: {100 * claimed:.0f} % tracked" if claimed else ""

    def known(self, place: Place) -> dict[tuple[str, int], list[Known]]:
        return {(self.log, 0): []}


@dataclass(frozen=True)
class Refused(Check):
    """The log is refused by a sentence that has these words, or nothing is tracked and a note has them."""

    log: str
    words: tuple[str, ...]  # small and capital letters are the same

    def wrong(self, place: Place) -> str:
        found = place.track(self.log)
        if any(tracks.tracked.any() for tracks in found.people):
            return f"{self.log} is tracked"
        said = " ".join((found.refused, *found.notes)).lower()
        missing = [word for word in self.words if word.lower() not in said]
        return f"{self.log}: nothing is said of {', '.join(missing)}" if missing else ""


@dataclass(frozen=True)
class Either(Check):
    """One of two."""

    one: Check
    other: Check

    def wrong(self, place: Place) -> str:
        said = [check.wrong(place) for check in (self.one, self.other)]
        return "" if "" in said else said[0]

    def known(self, place: Place) -> dict[tuple[str, int], list[Known]]:
        return self.one.known(place)


def beside(tracks: vj.Tracks, known: Known) -> Outcome | None:
    """Tracks compared with the truth at the times that have a frame: a case may have a part of a recording's frames."""
    if not len(tracks.time_ns):
        return None
    apart = np.abs(tracks.time_ns[None] - known.stamps[:, None])
    frame = apart.argmin(1)
    away = apart[np.arange(len(frame)), frame]
    first = known.stamps >= known.stamps[0] + 500_000_000
    rows = [
        rows[away[rows].argmin()]
        for k in range(len(tracks.time_ns))
        if len(rows := np.flatnonzero((frame == k) & (away < SAME_FRAME) & first))
    ]
    if len(rows) < 2:
        return None
    # the first half second is left out already: compared() is given a row that it may leave out
    before = known.stamps[rows[0]] - 10**9
    stamps = np.concatenate([[before], known.stamps[rows]])
    joints = np.concatenate([known.joints[rows[:1]], known.joints[rows]])
    return compared(tracks, Known(stamps, known.names, joints, {}))


def wrong_unsaid(place: Place, checks: Sequence[Check]) -> int:
    """How many logs have tracks of nobody who is in them (> 20 cm off), that say they are right; of people without a
    truth there may be as many as there are."""
    truths: dict[tuple[str, int], list[Known]] = {}
    people: dict[tuple[str, int], int] = {}
    for check in checks:
        for log, known in check.known(place).items():
            truths.setdefault(log, []).extend(known)
            people[log] = max(people.get(log, 0), getattr(check, "people", 0))
    return sum(
        sum(unsaid(tracks, truths[log]) for tracks in found.people) > max(people[log] - len(truths[log]), 0)
        for log, found in place.found.items()
        if log in truths
    )


def unsaid(tracks: vj.Tracks, people: Sequence[Known]) -> bool:
    """Whether tracks are far from all these people, yet say to be right most of the time, with confidence."""
    outcomes = [outcome for known in people if (outcome := beside(tracks, known)) is not None]
    if outcomes:
        return all(outcome.wrong_unsaid for outcome in outcomes)
    sure = tracks.confidence[np.isfinite(tracks.confidence)]
    return bool(tracks.tracked.mean() > 0.5 and sure.size and sure.mean() > 0.8)


FEW = 6  # notes: many of the same kind are one line
UNITS = ("read.scale",)  # the option that settles a unit
CASES: dict[str, tuple[Check, ...]] = {
    "01-split-bag": (Near("bag", "byebye-happy", 3.0, frames=55), Near("bag2", "byebye-happy", 3.0, frames=55)),
    "03-ros1-mcap": (Near("walk.mcap", "byebye-happy", 3.0, frames=55),),
    "04-depth-units": tuple(
        Either(Near(f"{name}.mcap", "byebye-happy", 3.0), Refused(f"{name}.mcap", UNITS))
        for name in ("l515", "d405", "mm-float")
    ),
    "06-device-clock": (
        Near("two.mcap", "byebye-happy", 3.0, frames=55),
        Near("moving.mcap", "byebye-happy", 4.0, frames=55),
    ),
    "07-kinect2-link": tuple(
        Near(f"{name}.mcap", "kinect2.truth.npz", 3.0) for name in ("kinect2", "azure", "kinect2-depth")
    ),
    "08-no-camera-info": (Refused("depth-only.mcap", ("read.camera",)),),
    "10-utm-root": (Near("utm.mcap", "byebye-happy", 3.0, frame="utm", at=(388108.0, 3949003.0, 0.0)),),
    "12-jpeg-depth": (Refused("jpeg.mcap", ("JPEG", "compressedDepth")),),
    "13-second-person": (
        Near("two.mcap", "subject.truth.npz", 5.0, people=2),
        Near("two.mcap", "visitor.truth.npz", 5.0, people=2, tracked=0.6),  # walks in from behind
    ),
    "14-counter": tuple(
        Near(f"{name}.mcap", "byebye-happy", 5.0, joints=UPPER, doubtful=LEGS)
        for name in ("table", "desk", "counter", "waist-up")
    ),
    "15-skirt": (
        Near("skirt.mcap", "guide-happy", 5.0, joints=UPPER, doubtful=LEGS),
        Near("skirt-walk.mcap", "walk-happy", 5.0, joints=UPPER, doubtful=LEGS),
        Near("backpack.mcap", "walk-right-happy", 5.0, joints=UPPER, doubtful=LEGS),
    ),
    "16-mannequin": (
        Nobody("empty.mcap"),
        Nobody("mannequin.mcap"),
        Near("late.mcap", "walk-happy", 3.5, never="sensors move"),
        Near("late-dummy.mcap", "walk-happy", 3.5, never="sensors move"),
    ),
    "17-two-marker-subjects": (
        Near("one.mcap", MARKED, 3.0),
        Near("two.mcap", MARKED, 3.0, people=2, first=3),  # today each of the 61 frames takes 10 s, in vain
    ),
    "19-other-marker-names": (
        Near("optitrack.mcap", MARKED, 3.5),
        Near("keypoints.mcap", "byebye-happy", 3.0),
        Near("text.mcap", MARKED, 3.0),
    ),
    # the files are first bytes only: what is said of them can be judged, not whether they are read
    "20-export": (Refused("walk.trc", ("TRC",)), Refused("walk.c3d", ("C3D",)), Refused("log.rrd", ("Rerun",))),
    "22-vendor-messages": (
        Either(Near("livox.mcap", "byebye-happy", 5.0), Refused("livox.mcap", ("xfer_format",))),
        Near("rgbd.mcap", "byebye-happy", 3.5),
        Near("mocap.mcap", MARKED, 3.0),
    ),
    "23-k4abt-skeletons": (Near("k4abt.mcap", "byebye-happy", 3.0, notes=FEW),),
    "24-two-hosts": (
        Near("offset.mcap", "walk-right-happy", 4.0),
        Near("control.mcap", "walk-right-happy", 4.0),
    ),
    "25-resized-image": (
        Either(Near("cropped.mcap", "bow-happy", 5.0), Refused("cropped.mcap", ("crop",))),
        Near("halved.mcap", "bow-happy", 3.5),
        Near("control-roi.mcap", "bow-happy", 5.0),
    ),
    "26-file-names": tuple(
        Near(name, "byebye-happy", 3.5, frames=19) for name in ("walk [1].mcap", "Gehen größe 行走.mcap")
    ),
    "27-one-camera-three-topics": tuple(Near(name, "guide-happy", 3.0) for name in ("all.mcap", "control.mcap")),
    "29-dropouts-at-start": (Near("dropouts.mcap", "guide-happy", 3.0, tracked=0.6, at_most=0.8),),
    "30-dark-jacket": tuple(Near(name, "guide-happy", 5.0) for name in ("dark.mcap", "mocap.mcap")),
    "31-unlabelled-markers": (Near("raw.mcap", MARKED, 3.0, notes=FEW),),
    "32-no-transforms": tuple(
        Near(f"{name}{kind}.mcap", f"{name}.truth.npz", 3.5)
        for name, kind in (("byebye-happy", ""), ("walk-happy", "-cloud"), ("bow-happy", ""), ("walk-right-happy", ""))
    ),
}
CONTROLS = (
    "26-file-names", "27-one-camera-three-topics", "29-dropouts-at-start", "30-dark-jacket", "32-no-transforms",
)  # fmt: skip
CHEAP = (
    "03-ros1-mcap", "08-no-camera-info", "12-jpeg-depth", "26-file-names", "27-one-camera-three-topics",
    "29-dropouts-at-start",
)  # fmt: skip


LONG = {"13-second-person": 70.0, "14-counter": 60.0, "30-dark-jacket": 50.0}  # seconds, mostly of making the logs


class CaseFound(NamedTuple):
    """How a case went."""

    name: str
    wrong: str  # what is wrong with it; empty: it is right
    unsaid: int  # logs that are wrong while they say they are right


@dataclass(frozen=True)
class Case:
    """Makes a case's logs, tracks them, and judges them."""

    folder: Path
    recordings: Path

    @property
    def seconds(self) -> float:
        return LONG.get(self.folder.name, 10.0 * len(CASES[self.folder.name]))

    def run(self) -> CaseFound:
        name = self.folder.name
        with tempfile.TemporaryDirectory() as made:
            if problem := make(self.folder, Path(made)):
                return CaseFound(name, problem, 0)
            place = Place(Path(made), self.recordings)
            said = [said for check in CASES[name] if (said := attempt(check.wrong, place))]
            return CaseFound(name, "; ".join(said), wrong_unsaid(place, CASES[name]))


def attempt(wrong: Callable[[Place], str], place: Place) -> str:
    """What is wrong; also if nothing came of it."""
    try:
        return wrong(place)
    except Exception as error:  # the other logs of the case are judged all the same
        return f"{type(error).__name__}: {error}"


def make(case: Path, folder: Path) -> str:
    """Writes the logs of a case to a folder: by its make.py, or they lie beside. Returns what went wrong."""
    script = case / "make.py"
    if not script.exists():
        for file in case.iterdir():
            if file.suffix not in (".md", ".txt"):
                (folder / file.name).write_bytes(file.read_bytes())
        return ""
    try:
        done = subprocess.run(
            [sys.executable, str(script)], cwd=folder, capture_output=True, text=True, timeout=TIMEOUT
        )
    except subprocess.TimeoutExpired:
        return f"make.py takes more than {TIMEOUT:.0f} s"
    return f"make.py failed: {done.stderr.strip().splitlines()[-1:]}" if done.returncode else ""
