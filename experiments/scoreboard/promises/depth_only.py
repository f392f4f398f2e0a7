"""Depth alone."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog, accuracy

PROMISE = Promise(
    name="depth_only",
    sentence="Depth alone, nothing given: 2.2 to 2.3 cm, 99.5 % of joints within 10 cm, none of 18 lost.",
    data="the 18 recordings",
    figures=(
        Figure("joints, cm", 2.3, tolerance=0.08),
        Figure("within 10 cm, %", 99.4, "more", 0.3, 1),
        Figure("lost", 0, tolerance=0, digits=0),
        Figure("acceptable", 1, tolerance=1, digits=0),
        Figure("false-well, %", 0.5, tolerance=0.5),
    ),
    jobs=lambda data: [TrackLog(log, features=False) for log in data.logs()],
    measure=accuracy,
)
