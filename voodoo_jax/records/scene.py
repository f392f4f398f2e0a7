"""The scene that bodies are in, floor and walls; and a person in a recording, with their measurements."""

from dataclasses import dataclass

from voodoo_jax.geometry.plane import Plane
from voodoo_jax.records.observation import BodyObservation


@dataclass(frozen=True)
class Scene:
    """The room's planes, found once from the first frames."""

    floor: Plane  # normal upwards
    walls: tuple[Plane, ...]  # normals towards the first sensor
    floor_seen: bool  # False: no floor was visible
    floor_open: bool = False  # nor is it known where it is: the lowest points stand for it, and it may be lower
    notes: tuple[str, ...] = ()  # how it was found, where that was not as the log says; one sentence each


@dataclass(frozen=True)
class Subject:
    """A person in a recording. Several people are several subjects."""

    number: int  # from 1: who is seen longest
    scene: Scene
    frames: list[BodyObservation]  # all of the recording; without points where they are not in view
    name: str = ""  # where the log says it
