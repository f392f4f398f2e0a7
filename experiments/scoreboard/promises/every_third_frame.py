"""Three times as fast as recorded: every third frame."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog, accuracy

PROMISE = Promise(
    name="every_third_frame",
    sentence="Every third frame of the recordings (10 Hz): 2.4 cm, none of 18 lost.",
    data="the 18 recordings, every third frame",
    figures=(
        Figure("joints, cm", 2.5, tolerance=0.1),
        Figure("within 10 cm, %", 99.0, "more", 0.5, 1),
        Figure("lost", 0, tolerance=0, digits=0),
        Figure("acceptable", 2, tolerance=1, digits=0),
    ),
    jobs=lambda data: [TrackLog(log, step=3) for log in data.logs()],
    measure=accuracy,
)
