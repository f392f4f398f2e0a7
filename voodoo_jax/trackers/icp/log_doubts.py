"""How far a log as a whole is believed: what is wrong in it moves all joints alike. Host side, NumPy."""

from typing import NamedTuple

from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.trackers.icp.right_level import Level, level_of
from voodoo_jax.trackers.icp.right_scale import Scale, scale_of


class LogDoubts(NamedTuple):
    """What is thought of a log's distances and of its fixed frame."""

    scale: Scale
    level: Level

    @property
    def right(self) -> float:
        """Probability that both are right, 0..1."""
        return self.scale.right * self.level.right


def log_doubts(body: Body, scene: Scene, people: list[BodyObservation], settings: Settings) -> LogDoubts:
    """What is thought of a log by its main body and its floor; `body` of the size that was found. What a user says of
    it settles it."""
    return LogDoubts(scale_of(body, scene, people, settings), level_of(scene, people, settings))
