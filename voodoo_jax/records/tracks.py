"""The result of tracking one recording, on the host: NumPy arrays and the body they belong to."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Float32, Int8, Int32, Int64

from voodoo_jax.model.body import Body


class Status(IntEnum):
    """What happened in one frame."""

    TRACKED = 0  # the body explains the person's points
    NOT_STARTED = 1  # before the tracker found somebody; poses are NaN
    NO_DATA = 2  # no points on the person in this frame; poses are predicted, or NaN if the person is gone for longer
    FEATURES = 4  # no points, but 2D features or a few 3D ones: poses follow these and are predicted else
    LOST = 3  # the body does not explain the points, or hardly a joint can be trusted; poses are the best guess


def expected_share(confidence: Float32[np.ndarray, "frame joint"]) -> Float32[np.ndarray, " frame"]:
    """Mean over the joints that there is a confidence of; NaN where there is none."""
    known = np.isfinite(confidence)
    total = np.where(known, confidence, 0).sum(1)
    return np.where(known.any(1), total / np.maximum(known.sum(1), 1), np.nan).astype(np.float32)


@dataclass(frozen=True)
class Tracks:
    """Poses of a body over a recording, in the recording's fixed frame. NaN where there is none."""

    source: str  # path of the log
    fixed_frame: str
    body: Body  # sizes as used or found, metres
    time_ns: Int64[np.ndarray, " frame"]
    rotation: Float32[np.ndarray, "frame limb 4"]  # T_fixed_limb, unit quaternion wxyz
    translation: Float32[np.ndarray, "frame limb 3"]  # metres
    joints: Float32[np.ndarray, "frame joint 3"]  # joint centres `body.topology.centres`, metres
    status: Int8[np.ndarray, " frame"]  # values of Status
    residual: Float32[np.ndarray, " frame"]  # root mean square distance of the used points, metres
    explained: Float32[np.ndarray, " frame"]  # share of the person's points that the body explains, 0..1
    steps: Int32[np.ndarray, " frame"]  # ICP steps taken
    points: Int32[np.ndarray, " frame"]  # points given to the tracker
    limb_weight: Float32[np.ndarray, "frame limb"]  # measured weight per limb: 0 for a limb that nothing was seen of
    # see trackers/icp/refine/forward_backward.py; metres; NaN: one pass only
    passes_apart: Float32[np.ndarray, "frame limb"] | None = None
    beyond_limits: Float32[np.ndarray, "frame bodyjoint"] | None = None  # of `body.topology.joints`, radians; 0: within
    depth_inside: Float32[np.ndarray, "frame limb"] | None = None  # in another limb, more than in the rest pose; metres
    limb_covariance: Float32[np.ndarray, "frame limb 6 6"] | None = None  # turn (rad), shift (m) in the limb's frame
    # of `joints`, square metres; solve/covariance.py
    joint_covariance: Float32[np.ndarray, "frame joint 3 3"] | None = None
    # of `joints`: within 10 cm? 0..1; see trackers/icp/confidence.py
    joint_confidence: Float32[np.ndarray, "frame joint"] | None = None
    seconds: float = 0.0  # time spent on tracking, without reading, writing and compiling
    compile_seconds: float = 0.0  # time spent on compiling
    notes: tuple[str, ...] = field(default=())
    person: int = 1  # number among the people of the recording: 1 who is seen longest
    people: int = 1  # how many of them are tracked

    @property
    def tracked(self) -> Bool[np.ndarray, " frame"]:
        """The tracker's own word that it has the person."""
        return self.status == Status.TRACKED

    @property
    def confidence(self) -> Float32[np.ndarray, " frame"]:
        """Share of the joints that is expected to be within 10 cm, 0..1; NaN where nothing tells."""
        if self.joint_confidence is None:
            return np.full(len(self.time_ns), np.nan, np.float32)
        return expected_share(self.joint_confidence)

    def joint(self, name: str) -> Float[np.ndarray, "frame 3"]:
        """Positions of one joint centre over time, metres."""
        return self.joints[:, self.body.topology.centres.index(name)]
