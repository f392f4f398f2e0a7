"""The flexible tracker on stereo pairs."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.promises.stereo import measure
from experiments.scoreboard.tracked import TrackLog

PROMISE = Promise(
    name="flexible",
    sentence="The flexible tracker on stereo pairs: at most 4.5 cm, nobody lost.",
    data="the nine recordings in stereo/",
    figures=(
        Figure("joints, cm", 4.5, tolerance=0.3),
        Figure("within 10 cm, %", 95.0, "more", 1.5, 1),
        Figure("lost", 0, tolerance=0, digits=0),
        Figure("worst log, cm", 6.0, tolerance=1.0, digits=1),
        Figure("wrong unsaid, logs", 0, tolerance=0, digits=0),
    ),
    jobs=lambda data: [TrackLog(log, preset="flexible") for log in data.part(data.logs("stereo"), 2)],
    measure=measure,
)
