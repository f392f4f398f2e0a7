"""The recording that comes with the package."""

from experiments.common import DEMO
from experiments.scoreboard.board import Figure, Promise
from experiments.scoreboard.tracked import TrackLog, accuracy

PROMISE = Promise(
    name="demo",
    sentence="The simulated person of the demo is tracked to 1.5 cm; it is made of the tracker's own kind of limbs.",
    data="the demo recording of the package",
    figures=(
        Figure("joints, cm", 1.5, tolerance=0.15),
        Figure("lost", 0, tolerance=0, digits=0),
    ),
    jobs=lambda data: [TrackLog(DEMO / "demo.mcap")],
    measure=accuracy,
)
