"""The result of tracking one recording, on the host: NumPy arrays and the body they belong to."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, Int8, Int32, Int64

from voodoo_jax.model.body import Body, segment_lengths
from voodoo_jax.model.isb_angles import Angles, joint_angles
from voodoo_jax.model.joint_names import joint_row, named
from voodoo_jax.records.notes import all_of, filled

RIGHT = 0.1  # metres: joint_confidence is the probability that a joint is nearer to its true place
SURE = 0.9  # share of the frames in which a joint is expected to be right: below it is named; by hand


def track_columns(tracks: "Tracks") -> dict[str, np.ndarray]:
    """Columns by name, which says the unit: stamps, `tracked`, residual, joint centres (fixed frame), their confidence,
    joint angles. NaN where there is nothing."""
    stamps = np.asarray(tracks.time_ns, np.int64)
    columns: dict[str, np.ndarray] = {
        "time_ns": stamps,
        "time_s": (stamps - stamps[:1]) / 1e9,
        "tracked": np.asarray(tracks.tracked),
        "residual_m": np.asarray(tracks.evidence.residual, float),
    }
    names = tracks.joint_names
    for i, name in enumerate(names):
        columns |= {f"{name}_{axis}_m": tracks.joints[:, i, k].astype(float) for k, axis in enumerate("xyz")}
    sure = tracks.joint_confidence
    for i, name in enumerate(names):
        nothing = np.full(len(stamps), np.nan)
        columns[f"{name}_confidence"] = nothing if sure is None else sure[:, i].astype(float)
    angles = tracks.angles()
    return columns | {f"{name}_deg": values for name, values in zip(angles.columns, np.degrees(angles.table).T)}


class Status(IntEnum):
    """What happened in one frame."""

    TRACKED = 0  # the body explains the person's points
    NOT_STARTED = 1  # before the tracker found a person; poses are NaN
    NO_DATA = 2  # no points on the person in this frame; poses are predicted, or NaN if the person is gone for longer
    FEATURES = 4  # no points, but 2D features or a few 3D ones: poses follow these and are predicted else
    LOST = 3  # the body does not explain the points, or hardly a joint can be trusted; poses are the best guess


STATUS_WORDS = {int(status): status.name.lower().replace("_", " ") for status in Status}
STATUS_WORDS[Status.FEATURES] = "features only"


def expected_share(confidence: Float32[np.ndarray, "frame joint"]) -> Float32[np.ndarray, " frame"]:
    """Mean over the joints that there is a confidence of; NaN where there is none."""
    known = np.isfinite(confidence)
    total = np.where(known, confidence, 0).sum(1)
    return np.where(known.any(1), total / np.maximum(known.sum(1), 1), np.nan).astype(np.float32)


@dataclass(frozen=True)
class Evidence:
    """Fit of the poses to the measurements. Leading axis: frame; NaN where there is none."""

    residual: Float32[np.ndarray, " frame"]  # root mean square distance of the used points, metres
    explained: Float32[np.ndarray, " frame"]  # share of the person's points that the body explains, 0..1
    steps: Int32[np.ndarray, " frame"]  # ICP steps taken
    points: Int32[np.ndarray, " frame"]  # points given to the tracker
    limb_weight: Float32[np.ndarray, "frame limb"]  # measured weight of each limb: 0 for a limb without measurements
    # distance of a limb between the forward and the backward pass, metres; NaN: one pass only
    passes_apart: Float32[np.ndarray, "frame limb"] | None = None
    # excess over the limits of `body.topology.joints`, radians; 0: within
    beyond_limits: Float32[np.ndarray, "frame bodyjoint"] | None = None
    # depth inside another limb, beyond that in the rest pose, metres
    depth_inside: Float32[np.ndarray, "frame limb"] | None = None
    limb_beside: Float32[np.ndarray, "frame limb"] | None = None  # unexplained share of a limb's nearest points
    limb_distance: Float32[np.ndarray, "frame limb"] | None = None  # their mean distance from it beyond noise, metres
    limb_bare: Float32[np.ndarray, "frame limb"] | None = None  # share of its length that is visible but without points
    limb_own: Float32[np.ndarray, "frame limb"] | None = None  # share of its points that no other limb explains
    # logarithm of the odds that the body faces forwards, not backwards
    facing_odds: Float32[np.ndarray, " frame"] | None = None
    matched: bool = False  # all points come from stereo matching

    @classmethod
    def blank(cls, count: int, limbs: int) -> "Evidence":
        """Of frames without points."""
        none = np.zeros(count, np.int32)
        weight = np.zeros((count, limbs), np.float32)
        return cls(np.full(count, np.nan, np.float32), np.zeros(count, np.float32), none, none.copy(), weight)


@dataclass(frozen=True)
class Tracks:
    """Poses of a body over a recording, in the recording's fixed frame. NaN where there is none."""

    source: str  # path of the log
    fixed_frame: str  # name of the frame of all poses
    body: Body  # sizes as used or found, metres
    time_ns: Int64[np.ndarray, " frame"]  # stamps of the log, nanoseconds
    rotation: Float32[np.ndarray, "frame limb 4"]  # T_fixed_limb, unit quaternion wxyz
    translation: Float[np.ndarray, "frame limb 3"]  # metres; float64 where coordinates are large, as in UTM
    joints: Float[np.ndarray, "frame joint 3"]  # joint centres `body.topology.centres`, metres
    status: Int8[np.ndarray, " frame"]  # values of Status
    evidence: Evidence  # residuals, weights and misfits
    # rotation (radians) and translation (metres) in the limb's frame
    limb_covariance: Float32[np.ndarray, "frame limb 6 6"] | None = None
    # of `joints`, square metres
    joint_covariance: Float32[np.ndarray, "frame joint 3 3"] | None = None
    # probability that each of `joints` is within 10 cm of the true one
    joint_confidence: Float32[np.ndarray, "frame joint"] | None = None
    # motion of sensors that the log describes as static, estimated from floor and walls: the transform to the fixed
    # frame from coordinates computed as if they were static; None: they are static
    T_fixed_steady: Float64[np.ndarray, "frame 4 4"] | None = None
    up: Float32[np.ndarray, "3"] | None = None  # upwards in the fixed frame, unit vector; None: not known
    # for logs of markers alone: root mean square distance of each from its fitted place on the body, metres
    marker_residual: Mapping[str, float] | None = None
    # lengths of segments that were measured between joint centres, metres, see segment_lengths
    segments: Mapping[str, float] | None = None
    seconds: float = 0.0  # time spent on tracking, without reading, writing and compiling
    compile_seconds: float = 0.0  # time spent on compiling
    notes: tuple[str, ...] = field(default=())  # one sentence each; those in brackets need no action
    person: int = 1  # number among the people of the recording: 1 is in view for longest
    people: int = 1  # how many of them are tracked
    names: tuple[str, ...] = ()  # of the joint centres, if they are not the body's own: see with_names

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joint centres, as files have them."""
        return self.names or self.body.topology.centres

    def with_names(self, convention: str) -> "Tracks":
        """The same with joint centres named by a convention, here and in files that are written of them: hanim (as in
        the body file), common (left_wrist), h36m, smpl, opensim; "": as they are. Raises ValueError for another one."""
        if not convention:
            return self
        names = named(self.body.topology.centres, convention)
        return replace(self, names=() if names == self.body.topology.centres else names)

    @property
    def tracked(self) -> Bool[np.ndarray, " frame"]:
        """In which frames the tracker has the person."""
        return self.status == Status.TRACKED

    @property
    def confidence(self) -> Float32[np.ndarray, " frame"]:
        """Share of the joints that is expected to be within 10 cm, 0..1; NaN where nothing tells."""
        if self.joint_confidence is None:
            return np.full(len(self.time_ns), np.nan, np.float32)
        return expected_share(self.joint_confidence)

    def segment_lengths(self) -> dict[str, float]:
        """Length of each named segment of the person, metres, left and right averaged: as measured between joint
        centres where that is more accurate, or that of the body."""
        return segment_lengths(self.body) | dict(self.segments or {})

    def since(self, first: int) -> "Tracks":
        """The same without the frames before `first`."""
        return self.only(slice(first, None)) if first else self

    def rows(self) -> dict[str, np.ndarray]:
        """Its arrays that have a row for each frame, those of the evidence among them, by name."""
        each = vars(self) | vars(self.evidence)
        return {name: value for name, value in each.items() if isinstance(value, np.ndarray) and name != "up"}

    def having(self, **rows: np.ndarray | None) -> "Tracks":
        """The same with other arrays, which may be those of the evidence."""
        theirs = {name: rows.pop(name) for name in vars(self.evidence) if name in rows}
        return replace(self, evidence=replace(self.evidence, **theirs), **rows)

    def only(self, frames: slice | Int[np.ndarray, " chosen"]) -> "Tracks":
        """Some of the frames, by a slice or their rows."""
        return self.having(**{name: value[frames] for name, value in self.rows().items()})

    def joint(self, name: str) -> Float[np.ndarray, "frame 3"]:
        """Positions of one joint centre over time, metres.

        Names of other conventions are understood: left_wrist, LWrist, WRIST_LEFT (see model/joint_names.py). Raises
        ValueError with near names.
        """
        own = self.joint_names
        return self.joints[:, own.index(name) if name in own else joint_row(self.body.topology.centres, name)]

    def to_pandas(self) -> Any:
        """A pandas DataFrame, a row for each frame: the columns of an exported CSV file (metres, degrees), by seconds
        since the first frame. Raises ImportError with what to install."""
        try:
            import pandas
        except ImportError as problem:
            raise ImportError('to_pandas needs pandas: pip install "voodoo_jax[pandas]"') from problem
        columns = track_columns(self)
        return pandas.DataFrame(columns, index=pandas.Index(columns.pop("time_s"), name="time_s"))

    def __repr__(self) -> str:
        return f"Tracks({', '.join(value for _, value in self._summary())})"

    def _repr_html_(self) -> str:
        rows = [*self._summary(), *(("note", note) for note in self.notes)]
        cells = all_of(
            filled("<tr><th>@NAME@</th><td>@VALUE@</td></tr>", NAME=name, VALUE=value) for name, value in rows
        )
        return filled("<table><caption>Tracks</caption>@CELLS@</table>", CELLS=cells)

    def _summary(self) -> list[tuple[str, str]]:
        count, body = len(self.time_ns), self.body
        seconds = (int(self.time_ns[-1]) - int(self.time_ns[0])) / 1e9 if count else 0.0
        residual = self.evidence.residual
        known = residual[np.isfinite(residual)]
        found = [
            ("source", self.source),
            ("frames", f"{count} frames in {seconds:.2f} s"),
            ("tracked", f"{100 * self.tracked.mean() if count else 0:.0f} % tracked"),
        ]
        if len(known):
            found.append(("residual", f"residual {1000 * float(known.mean()):.0f} mm"))
        return [*found, ("body", f"{body.name}, {body.scale_name} {float(body.scale):.3f} m")]

    def angles(self, hidden: bool = False) -> Angles:
        """Joint angles over time, radians, with their covariances: see model/isb_angles.py for what they are.

        NaN in frames that are not tracked and, unless `hidden`, where nothing was seen of one of a joint's limbs.
        """
        seen = (self.evidence.limb_weight > 0) | hidden
        return joint_angles(self.body, self.rotation, seen & self.tracked[:, None], self.limb_covariance)


@runtime_checkable
class Given(Protocol):
    """What a log says of all places that were measured in it."""

    @property
    def origin(self) -> Float64[np.ndarray, "3"]: ...  # from where they are given in the fixed frame, metres

    @property
    def sure(self) -> float: ...  # probability that they are right, where a calibration was assumed


def for_users(tracks: Tracks, log: Given) -> Tracks:
    """Tracks with places in the log's fixed frame, and confidence that counts what was assumed of its calibration, for
    all joints alike; joints that can hardly be trusted with that are named in a note."""
    tracks = scale_confidence(given_from(tracks, log.origin), log.sure)
    return replace(tracks, notes=(*tracks.notes, *_doubtful(tracks)))


def _doubtful(tracks: Tracks) -> list[str]:
    """A sentence on joints that can hardly be trusted."""
    tracked = tracks.tracked
    if tracks.joint_confidence is None or not tracked.any():
        return []
    share = tracks.joint_confidence[tracked].mean(0)
    few = [f"{tracks.joint_names[k]} ({100 * share[k]:.0f} %)" for k in np.argsort(share) if share[k] < SURE]
    what = "Doubtful joints (share of the tracked frames in which they are expected within 10 cm)"
    return [f"{what}: {', '.join(few)}."] if few else []


def scale_confidence(tracks: Tracks, sure: float) -> Tracks:
    """Tracks of a log whose places are right with the probability `sure` only, for all joints alike."""
    if sure >= 1 or tracks.joint_confidence is None:
        return tracks
    return replace(tracks, joint_confidence=tracks.joint_confidence * np.float32(sure))


def given_from(tracks: Tracks, origin: Float[np.ndarray, "3"]) -> Tracks:
    """Tracks whose places are given from an origin (metres), as places in the fixed frame: in float64, unless it is 0.

    With `-origin` the way back, where float32 is exact enough.
    """
    if not np.any(origin):
        return tracks
    translation, joints = (places.astype(np.float64) + origin for places in (tracks.translation, tracks.joints))
    return replace(tracks, translation=translation, joints=joints)
