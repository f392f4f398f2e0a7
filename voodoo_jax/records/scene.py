"""The scene that a body is in: floor and walls."""

from dataclasses import dataclass

from voodoo_jax.geometry.plane import Plane


@dataclass(frozen=True)
class Scene:
    """The room's planes, found once from the first frames."""

    floor: Plane  # normal upwards
    walls: tuple[Plane, ...]  # normals towards the first sensor
    floor_seen: bool  # False: no floor was visible
    floor_open: bool = False  # nor is it known where it is: the lowest points stand for it, and it may be lower
    notes: tuple[str, ...] = ()  # how it was found, where that was not as the log says; one sentence each
