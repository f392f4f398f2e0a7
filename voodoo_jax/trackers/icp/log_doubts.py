"""Reliability of a log as a whole: its errors affect all joints equally. Host side, NumPy."""

from typing import NamedTuple

from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.trackers.icp.right_level import Level, level_of
from voodoo_jax.trackers.icp.right_scale import Scale, scale_of


class LogDoubts(NamedTuple):
    """Estimates about a log's distances and its fixed frame."""

    scale: Scale
    level: Level

    @property
    def right(self) -> float:
        """Probability that both are right, 0..1."""
        return self.scale.right * self.level.right


def log_doubts(body: Body, scene: Scene, people: list[BodyObservation], settings: Settings) -> LogDoubts:
    """Estimates about a log from its main body and its floor; `body` with the estimated size. Settings by the user
    override them."""
    return LogDoubts(scale_of(body, scene, people, settings), level_of(scene, people, settings))
