"""Removes sensor motion that no transform reports, see camera_motion.py."""

from dataclasses import dataclass, replace
from typing import ClassVar

from voodoo_jax.detect.camera_motion import steadied
from voodoo_jax.detect.stage import Surroundings


@dataclass(frozen=True)
class SteadySensors:
    """The frames as if all sensors had kept the pose in which floor and walls were found."""

    name: ClassVar = "steady_sensors"
    looks_ahead: ClassVar = False
    needs: ClassVar = frozenset()

    def __call__(self, found: Surroundings) -> Surroundings:
        return replace(found, frames=steadied(found.frames, found.planes))
