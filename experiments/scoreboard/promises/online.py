"""No look into the future."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog, accuracy

PROMISE = Promise(
    name="online",
    sentence="With --online, each frame by what came before it: 2.0 cm, none of 18 lost.",
    data="the 18 recordings",
    figures=(
        Figure("joints, cm", 2.3, tolerance=0.15),
        Figure("within 10 cm, %", 99.0, "more", 0.7, 1),
        Figure("lost", 0, tolerance=0, digits=0),
        Figure("acceptable", 1, tolerance=1, digits=0),
        Figure("false-well, %", 1.0, tolerance=1.0),
    ),
    jobs=lambda data: [TrackLog(log, online=True) for log in data.logs()],
    measure=accuracy,
)
