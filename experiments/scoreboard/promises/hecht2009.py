"""The system of Hecht, Azad and Dillmann 2009 as the paper has it, to compare with."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog, accuracy

PROMISE = Promise(
    name="hecht2009",
    sentence="The preset hecht2009 is the paper's system; it loses most limbs within seconds.",
    data="the nine recordings in stereo/",
    figures=(
        Figure("joints, cm", None),
        Figure("within 10 cm, %", None, "more", digits=1),
        Figure("lost", None, digits=0),
    ),
    jobs=lambda data: [TrackLog(log, preset="hecht2009") for log in data.part(data.logs("stereo"), 2)],
    measure=accuracy,
)
