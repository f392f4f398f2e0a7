"""Several people in one log."""

from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.people_score import TrackPeople, figures

PROMISE = Promise(
    name="people",
    sentence="All people in view are tracked, each as one.",
    data="the six recordings in people/",
    figures=(
        Figure("found, %", 97.0, "more", 3.0, 1),
        Figure("joints, cm", 3.0, tolerance=0.8),
        Figure("false, %", 1.0, tolerance=2.0, digits=1),
        Figure("switches", 0, tolerance=0, digits=0),
        Figure("idf1, %", 97.0, "more", 3.0, 1),
    ),
    jobs=lambda data: [TrackPeople(log) for log in data.part(data.logs("people"), 2)],
    measure=figures,
)
