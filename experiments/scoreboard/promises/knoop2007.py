"""The papers' chain of 2007, to compare with."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog, accuracy

PROMISE = Promise(
    name="knoop2007",
    sentence="The preset knoop2007 is the papers' chain with its ten-limb body.",
    data="the 18 recordings",
    figures=(
        Figure("joints, cm", None),
        Figure("within 10 cm, %", None, "more", digits=1),
        Figure("lost", None, digits=0),
    ),
    jobs=lambda data: [TrackLog(log, preset="knoop2007") for log in data.part(data.logs(), 2)],
    measure=accuracy,
)
