"""One log, tracked and compared with its truth: the job that most promises share."""

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

import voodoo_jax as vj
from experiments.common import NEAR_NS, SKIP, errors, grade, nearest, off
from voodoo_jax.model.body_file import load_body

INSIDE = float(chi2.ppf(0.95, 3))  # squared Mahalanobis distance that holds 95 % of a normal distribution in space
WRONG = 0.20  # metres of mean joint error: the log is of somebody or something else, or turned round


class Known(NamedTuple):
    """The truth of a recording."""

    stamps: np.ndarray  # [time] nanoseconds
    names: tuple[str, ...]  # H-Anim names of joints as bodies call them
    joints: np.ndarray  # [time, joint, 3] metres, fixed frame; NaN: not known
    dims: dict[str, float]  # stature and mean lengths of segments, metres; NaN: nobody measured it


class Outcome(NamedTuple):
    """How a log went, times of the truth after its first half second."""

    error: np.ndarray  # [time, joint] metres; 1 where there is no answer, NaN without a truth
    names: tuple[str, ...]
    grade: int  # 0 lost, 1 acceptable, 2 good
    claimed: np.ndarray  # [time] said to be tracked
    off: np.ndarray  # [time] trunk or two limbs are more than 20 cm off
    confidence: np.ndarray  # [time, joint] said probability to be within 10 cm; NaN: nothing is said
    inside: np.ndarray  # [time, joint] 1 in the 95 % region of its covariance, 0 outside, NaN without one
    segments_cm: float  # mean distance of segment lengths from the truth; NaN without one
    stature_cm: float

    @property
    def error_cm(self) -> float:
        """Mean over times and joints."""
        return 100 * float(np.nanmean(self.error))

    @property
    def wrong_unsaid(self) -> bool:
        """More than 20 cm off on average, yet said to be tracked most of the time, with confidence."""
        sure = self.confidence[np.isfinite(self.confidence)]
        return bool(
            np.nanmean(self.error) > WRONG and self.claimed.mean() > 0.5 and sure.size and sure.mean() > 0.8
        )  # fmt: skip


def read_known(path: Path) -> Known:
    """The truth in an .npz file: `time_ns`, `names`, `joints`, `dims`."""
    alias = {
        "l_wrist": "l_radiocarpal",
        "r_wrist": "r_radiocarpal",
        "l_ankle": "l_talocrural",
        "r_ankle": "r_talocrural",
    }
    with np.load(path, allow_pickle=False) as file:
        names = tuple(alias.get(str(n), str(n)) for n in file["names"])
        dims = json.loads(str(file["dims"])) if "dims" in file else {}
        return Known(file["time_ns"].astype(np.int64), names, file["joints"].astype(float), dims)


@lru_cache(maxsize=1)
def recording_of(path: Path, features: bool = True, preset: str = "default") -> vj.Recording:
    """A log in memory; the last one is kept, for several variants of a log may follow each other."""
    return vj.read_log(path, replace(vj.preset(preset).read, features=features))


def compared(tracks: vj.Tracks, known: Known) -> Outcome:
    """Tracks beside the truth."""
    centres = tracks.body.topology.centres
    names = tuple(n for n in known.names if n in centres)
    columns = [known.names.index(n) for n in names]
    use = known.stamps >= known.stamps[0] + int(SKIP * 1e9)
    known = Known(known.stamps[use], names, known.joints[use][:, columns], known.dims)
    mine = [centres.index(n) for n in names]
    error = errors(known, tracks)
    frame, near = nearest(known, tracks)
    rate = 1e9 / float(np.median(np.diff(known.stamps)))
    confidence = _of(tracks.joint_confidence, frame, mine, error.shape)
    inside = np.full(error.shape, np.nan)
    if tracks.joint_covariance is not None:
        covariance = tracks.joint_covariance[frame][:, mine].astype(float)
        away = tracks.joints[frame][:, mine].astype(float) - known.joints
        told = np.isfinite(covariance).all((-1, -2)) & np.isfinite(away).all(-1) & near[:, None]
        covariance[~told], away[~told] = np.eye(3), 0
        square = np.einsum("tja,tja->tj", away, np.linalg.solve(covariance, away[..., None])[..., 0])
        inside = np.where(told, square <= INSIDE, np.nan)
    body = tracks.segment_lengths()
    segments = [abs(body[k] - v) for k, v in known.dims.items() if k in body and v is not None and np.isfinite(v)]
    stature = known.dims.get("stature")
    return Outcome(
        error, names, grade(error, names, rate), tracks.tracked[frame] & near, off(error, names),
        np.where(near[:, None], confidence, np.nan), inside,
        100 * float(np.mean(segments)) if segments else float("nan"),
        float("nan") if stature is None else 100 * abs(float(tracks.body.scale) - stature),
    )  # fmt: skip


def _of(values: np.ndarray | None, frame: np.ndarray, joints: list[int], shape: tuple[int, ...]) -> np.ndarray:
    return np.full(shape, np.nan) if values is None else values[frame][:, joints].astype(float)


@dataclass(frozen=True)
class TrackLog:
    """Tracks a log as `voodoo-jax replay` does, nothing given."""

    log: Path
    features: bool = True  # named 2D and 3D features too
    online: bool = False  # no look into the future
    step: int = 1  # every so manieth frame only
    truth: Path | None = None  # None: beside the log
    preset: str = "default"

    def run(self) -> Outcome:
        recording = recording_of(self.log, self.features, self.preset)
        recording = replace(recording, frames=recording.frames[:: self.step])
        settings = vj.preset(self.preset)
        body = load_body("human10" if self.preset == "knoop2007" else "human")
        tracks = vj.track(body, recording, vj.online(settings) if self.online else settings)
        known = read_known(self.truth or self.log.with_suffix(".truth.npz"))
        if self.step > 1:  # frames that were left out on purpose are not missed
            kept = np.abs(known.stamps[:, None] - tracks.time_ns[None]).min(1) < NEAR_NS
            known = known._replace(stamps=known.stamps[kept], joints=known.joints[kept])
        return compared(tracks, known)


def accuracy(outcomes: list[Outcome]) -> dict[str, float]:
    """Means over logs, as score.py of the recordings has them."""
    grades = [o.grade for o in outcomes]
    return {
        "joints, cm": float(np.mean([o.error_cm for o in outcomes])),
        "within 10 cm, %": 100 * float(np.mean([np.mean(o.error[np.isfinite(o.error)] < 0.1) for o in outcomes])),
        "lost": grades.count(0),
        "acceptable": grades.count(1),
        "false-well, %": 100 * float(np.mean([(o.claimed & o.off).mean() for o in outcomes])),
    }
