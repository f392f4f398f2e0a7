"""Other people and movements, recorded as the 18 were; drawn anew by each seed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.people.others import Other, make, others
from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.promises.confidence import said_and_right
from experiments.scoreboard.tracked import Outcome, TrackLog, accuracy
from experiments.trust.__main__ import rank

LOGS = 48
WAYS = {"fusion": {}, "depth only": {"features": False}, "online": {"online": True}}


@dataclass(frozen=True)
class TrackOther:
    """One log, made if there is none, and tracked in all ways."""

    other: Other
    seconds = 12.0

    def run(self) -> dict[str, Outcome]:
        path = make(self.other)
        return {name: TrackLog(path, **way).run() for name, way in WAYS.items()}


def jobs(data: Data) -> list[TrackOther]:
    """None when quick, and none without people of that draw, or clips."""
    if data.others is None or data.quick:
        return []
    bodies, logs = (data.others / f"{name}-{data.draw}" for name in ("bodies", "logs"))
    bodies = bodies.with_name(f"{bodies.name}.npz")
    if not bodies.exists() or not any(data.others.glob("*.bvh")):
        return []
    logs.mkdir(exist_ok=True)
    return [TrackOther(other) for other in others(bodies, data.others, logs, data.draw, LOGS)]


def measure(found: Sequence[dict[str, Outcome]]) -> dict[str, float]:
    """Means over logs; regions and confidence by the worst of the ways."""
    ways = {way: [each[way] for each in found] for way in WAYS}
    inside = [100 * float(np.nanmean(np.concatenate([o.inside.ravel() for o in logs]))) for logs in ways.values()]
    joints = {f"{way}: joints, cm": accuracy(logs)["joints, cm"] for way, logs in ways.items()}
    return joints | {
        "lost": sum(accuracy(logs)["lost"] for logs in ways.values()),
        "segments, cm": float(np.mean([o.segments_cm for o in ways["fusion"]])),
        "right trusted more than wrong, %": 100 * min(rank(*said_and_right(logs)) for logs in ways.values()),
        "truth inside 95 % regions, off 95 %": max(abs(share - 95) for share in inside),
    }


PROMISE = Promise(
    name="others",
    sentence="Other people and movements, recorded as the 18 were: 2 cm, online 2.4, none lost.",
    data="folder given by --others that has bodies and clips",
    figures=(
        Figure("fusion: joints, cm", 2.0),
        Figure("depth only: joints, cm", 2.1),
        Figure("online: joints, cm", 2.4),
        Figure("lost", 0, digits=0),
        Figure("segments, cm", 0.8),
        Figure("right trusted more than wrong, %", 95.0, "more", digits=1),
        Figure("truth inside 95 % regions, off 95 %", 1.0),
    ),
    jobs=jobs,
    measure=measure,
)
