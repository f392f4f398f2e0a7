"""A person in a recording, and their measurements."""

from dataclasses import dataclass

from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene


@dataclass(frozen=True)
class Subject:
    """A person in a recording. Several people are several subjects."""

    number: int  # from 1: who is seen longest
    scene: Scene
    frames: list[BodyObservation]  # all of the recording; without points where they are not in view
    name: str = ""  # where the log says it
