"""Formats of files that become bodies, and their readers."""

import os
from collections.abc import Mapping
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from voodoo_jax.config.limited import LARGEST, limited, limits
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.model.checked_toml import BodyFileError
from voodoo_jax.storage.guard import Refused, Room, guarded
from voodoo_jax.storage.troubles import check_file

if TYPE_CHECKING:
    from voodoo_jax.model.body import Body
    from voodoo_jax.storage.guarded import Answer

KINDS = {".urdf": "URDF", ".glb": "glTF", ".gltf": "glTF"}
READERS = {"URDF": ("urdf", "read_urdf"), "glTF": ("skinned_mesh", "read_skinned")}
MOST = 1 << 24  # bytes of a body file
LEAST = 0.03  # metres: what is smaller no depth camera of some metres' reach shows


def body_from(
    path: str | os.PathLike[str], rest: Mapping[str, float] | None = None, least: float = LEAST
) -> "tuple[Body, list[str]]":
    """A body of a robot description (URDF) or a skinned mesh (glTF), its limbs the nearest tapered elliptic cylinders.

    **Arguments:** `rest` joint values of a URDF in the rest pose, radians (0 for others, or the nearest to it within
    their limits); the rest pose should be one that the joints can leave both ways; `least` metres: parts that are
    smaller in all directions become one with what they hang on.

    **Returns:** the body, in metres as the file says, and what was left out or fits badly, one sentence each. Write it
    by `write_body`; the tracker finds its size unless `start.scale` is `float(body.scale)`.

    It is read in a process of its own (storage/guard.py). Raises BodyFileError.
    """
    path = Path(path)
    try:
        if not path.exists():
            raise FileNotFoundError("there is no such file")
        check_file(path)
    except OSError as problem:
        raise BodyFileError(str(path), None, problem.strerror or str(problem)) from problem
    kind = KINDS.get(path.suffix.lower())
    if kind is None:
        raise BodyFileError(str(path), None, f"supported files are {', '.join(KINDS)}")
    if not 0 <= least <= LARGEST:
        raise BodyFileError(str(path), None, f"--least {least}: must be from 0 to {LARGEST:g} metres")
    if not all(abs(value) <= LARGEST for value in (rest or {}).values()):
        raise BodyFileError(str(path), None, f"--rest: joint values must be numbers up to {LARGEST:g}")
    if rest and kind != "URDF":
        raise BodyFileError(str(path), None, "joint values of the rest pose are for URDF; a mesh has its own")
    module, function = READERS[kind]
    most, text = limits(), bytearray()
    task = [module, function, str(path), dict(rest or {}), least, asdict(most)]
    room, places = Room(most.memory, most.seconds, MOST), [str(path.resolve()), str(folder_of(path))]
    try:
        imports = [f"voodoo_jax.model.foreign.{module}"]
        notes = guarded("voodoo_jax.model.foreign.sources:made", task, places, room, text.extend, imports)
    except Refused as problem:
        why = str(problem).removeprefix(f"{path}: ")
        raise BodyFileError(
            str(path), None, why if "cannot be" in why else f"it cannot be read as {kind}: {why}"
        ) from problem
    from voodoo_jax.model.body_file import parse_body

    return parse_body(text.decode("utf-8", "replace"), str(path)), notes


def folder_of(path: Path) -> Path:
    """The folder that must contain all files that a file refers to: its own, or that of its ROS package."""
    above = path.resolve().parents
    return next((folder.parent for folder in above if (folder / "package.xml").is_file()), above[0])


# 6 parameters: those of the task, and where its answer goes
def made(module: str, function: str, path: str, rest: dict, least: float, allowed: dict, answer: "Answer") -> list[str]:
    """Runs in the restricted process: the text of a body file."""
    read: Any = getattr(import_module(f"voodoo_jax.model.foreign.{module}"), function)
    try:
        with limited(LimitSettings(**allowed)):
            text, notes = read(Path(path), rest, least)
    except (BodyFileError, OSError, MemoryError):
        raise
    except Exception as problem:  # each format's parsers have their own
        raise ValueError(f"unexpected {type(problem).__name__}: {problem}") from problem
    answer.write(text.encode("utf-8", "backslashreplace"))
    return notes
