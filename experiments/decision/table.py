"""One row for each object in which a body is looked for, and for each tracklet: features, and whether it is a person.

A person is what has most of its points within 0.3 m of the truth's bones and half of all such points at least. Parts
of people are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from jaxtyping import Float, Float32, Int64

from experiments.common import NEAR_NS, human
from experiments.decision.features import described
from voodoo_jax.config.options import Settings
from voodoo_jax.detect import segmentation
from voodoo_jax.detect.body_likelihood import candidate
from voodoo_jax.detect.pipeline import surroundings
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.records.recording import Frame

NEAR, EVERY = 0.3, 12  # metres from a bone; looks for people from scratch in each log
MOST, FEW = 0.6, 0.3  # of its points are a person's: it may be one; it is none
WHOLE = 0.5  # of a person's points: it is that person, not a part
BONES = (
    ("skullbase", "vc7"), ("vc7", "l_hip"), ("vc7", "r_hip"), ("l_shoulder", "r_shoulder"), ("l_hip", "r_hip"),
    *((f"{side}_{upper}", f"{side}_{lower}") for side in "lr" for upper, lower in (
        ("shoulder", "elbow"), ("elbow", "radiocarpal"), ("hip", "knee"), ("knee", "talocrural"))),
)  # fmt: skip
SNAPSHOTS = (15, 30, 60, 120, 240)  # frames after which the features of a tracklet are taken, too


@dataclass(frozen=True)
class Labelled:
    """A recording, and who is where in it."""

    kind: str
    name: str
    frames: Sequence[Frame]
    up: Float32[np.ndarray, "3"]
    stamps: Int64[np.ndarray, " time"]  # nanoseconds; none: nobody is in it
    names: tuple[str, ...]
    joints: Float[np.ndarray, "person time joint 3"]  # metres, NaN: not known

    def knows(self, frame_ns: int) -> bool:
        """Whether the truth says who is where, or that nobody is."""
        off = np.abs(self.stamps - frame_ns)
        return not len(off) or bool(off.min() < NEAR_NS and np.isfinite(self.joints[:, off.argmin()]).any())

    def on_people(self, frame_ns: int, points: Float32[np.ndarray, "point 3"]) -> np.ndarray:
        """Which person each point is on; -1: none."""
        whose = np.full(len(points), -1)
        if not len(self.stamps):
            return whose
        at, nearest = int(np.argmin(np.abs(self.stamps - frame_ns))), np.full(len(points), NEAR)
        for person, joints in enumerate(self.joints[:, at]):
            for pair in BONES:
                if not set(pair) <= set(self.names):
                    continue
                a, b = (joints[self.names.index(name)] for name in pair)
                if not np.isfinite([a, b]).all():
                    continue
                along = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-9), 0, 1)
                off = np.linalg.norm(points - a - along[:, None] * (b - a), axis=1)
                whose[off < nearest], nearest = person, np.minimum(off, nearest)
        return whose


class Row(NamedTuple):
    """An object in a frame, or a tracklet."""

    kind: str
    log: str
    look: int  # which one of the log: objects that are there together
    person: bool
    features: tuple[float, ...]
    rule: float  # how likely detect/body_likelihood.py finds it; 0: it cannot be the body


def objects(log: Labelled) -> list[Row]:
    """The objects that are found in some frames, when nobody is known yet."""
    settings, rows = Settings(), list[Row]()
    found = surroundings(log.frames, log.up, human(), settings)
    for look, frame in enumerate(log.frames[:: max(1, len(log.frames) // EVERY)]):
        if not log.knows(frame.time_ns):
            continue

        def seen(points, label, area, distance, places, body, least, look=look, frame=frame):
            things, features = described(points, label, places, body)
            whose = log.on_people(frame.time_ns, points)
            for k, row in zip(things, features):
                mine = label == k
                if (person := _is_person(whose, mine)) is not None:
                    near = points[mine], label[mine], area[mine], distance[mine], places[:, mine]
                    rows.append(Row(log.kind, log.name, look, person, tuple(row), candidate(*near, body, least)[2]))
            return -1, 0.0, 0.0

        with patch.object(segmentation, "candidate", seen):
            BodySegmenter(found.scene, found.build, settings.detect)(frame)
    return rows


def _is_person(whose: np.ndarray, mine: np.ndarray) -> bool | None:
    """Whether an object is a person; None: one among other things, or a part of one."""
    count = np.bincount(whose[mine] + 1, minlength=whose.max() + 2)
    share = 1 - count[0] / count.sum()
    if share < FEW:
        return False
    who = int(np.argmax(count[1:]))
    return True if share > MOST and count[1 + who] > WHOLE * np.sum(whose == who) else None
