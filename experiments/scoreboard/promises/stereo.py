"""Stereo pairs."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import Outcome, TrackLog, accuracy


def measure(logs: list[Outcome]) -> dict[str, float]:
    """Accuracy, and logs that are wrong unsaid: a person taken for their back is."""
    return {
        **accuracy(logs),
        "worst log, cm": max(o.error_cm for o in logs),
        "wrong unsaid, logs": sum(o.wrong_unsaid for o in logs),
    }


PROMISE = Promise(
    name="stereo",
    sentence="Stereo pairs (640x480, JPEG): nobody is tracked back to front.",
    data="the nine recordings in stereo/",
    figures=(
        Figure("joints, cm", 5.0, tolerance=0.5),
        Figure("within 10 cm, %", 95.0, "more", 2.0, 1),
        Figure("lost", 0, tolerance=0, digits=0),
        Figure("worst log, cm", 10.0, tolerance=3.0, digits=1),
        Figure("wrong unsaid, logs", 0, tolerance=0, digits=0),
    ),
    jobs=lambda data: [TrackLog(log) for log in data.part(data.logs("stereo"), 2)],
    measure=measure,
)
