"""Depth and 2D features of face and hands."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog, accuracy

PROMISE = Promise(
    name="fusion",
    sentence="Depth and 2D features, nothing given: 2.1 cm, 99.8 % of joints within 10 cm, none of 18 lost.",
    data="the 18 recordings",
    figures=(
        Figure("joints, cm", 2.1, tolerance=0.08),
        Figure("within 10 cm, %", 99.7, "more", 0.3, 1),
        Figure("lost", 0, tolerance=0, digits=0),
        Figure("acceptable", 0, tolerance=1, digits=0),
        Figure("false-well, %", 0.5, tolerance=0.5),
    ),
    jobs=lambda data: [TrackLog(log) for log in data.logs()],
    measure=accuracy,
)
