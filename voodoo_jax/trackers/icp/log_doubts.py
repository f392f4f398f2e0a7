"""How far a log as a whole is believed: what is wrong in it moves all joints alike. Host side, NumPy."""

from typing import NamedTuple

from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.trackers.icp.right_level import Level, level_of
from voodoo_jax.trackers.icp.right_scale import Scale, scale_of

# share of logs with left and right exchanged in all names, not in the coordinates, as left-handed ones have; by hand
MISNAMED = 0.2


class LogDoubts(NamedTuple):
    """What is thought of a log's distances, of its fixed frame, and of its sides."""

    scale: Scale
    level: Level
    sides: float  # probability that left and right of its named points are as they were taken, 0..1

    @property
    def right(self) -> float:
        """Probability that all are right, 0..1."""
        return self.scale.right * self.level.right * self.sides


def log_doubts(
    body: Body, scene: Scene, people: list[BodyObservation], settings: Settings, mirrored: bool = False
) -> LogDoubts:
    """What is thought of a log by its main body and its floor; `body` of the size that was found, `mirrored` where left
    and right of all named points were exchanged. What a user says of it settles it."""
    sides = MISNAMED if mirrored and not settings.read.mirror else 1.0
    return LogDoubts(scale_of(body, scene, people, settings), level_of(scene, people, settings), sides)
