"""Which files become bodies, and by what."""

import os
from collections.abc import Mapping
from pathlib import Path

from voodoo_jax.config.bounds import LARGEST
from voodoo_jax.model.body import Body
from voodoo_jax.model.body_file import BodyFileError

KINDS = {".urdf": "URDF", ".glb": "glTF", ".gltf": "glTF"}
LEAST = 0.03  # metres: what is smaller no depth camera of some metres' reach shows


def body_from(
    path: str | os.PathLike[str], rest: Mapping[str, float] | None = None, least: float = LEAST
) -> tuple[Body, list[str]]:
    """A body of a robot description (URDF) or a skinned mesh (glTF), its limbs the nearest tapered elliptic cylinders.

    **Arguments:** `rest` joint values of a URDF in the rest pose, radians (0 for others, or the nearest to it within
    their limits); the rest pose should be one that the joints can leave both ways; `least` metres: parts that are
    smaller in all directions become one with what they hang on.

    **Returns:** the body, in metres as the file says, and what was left out or fits badly, one sentence each. Write it
    by `write_body`; the tracker finds its size unless `start.scale` is `float(body.scale)`.

    Raises BodyFileError.
    """
    path = Path(path)
    if not path.is_file():
        raise BodyFileError(str(path), None, "there is no such file")
    kind = KINDS.get(path.suffix.lower())
    if kind is None:
        raise BodyFileError(str(path), None, f"bodies are made of {', '.join(KINDS)} files")
    if not 0 <= least <= LARGEST:
        raise BodyFileError(str(path), None, f"--least {least}: must be from 0 to {LARGEST:g} metres")
    if not all(abs(value) <= LARGEST for value in (rest or {}).values()):
        raise BodyFileError(str(path), None, f"--rest: joint values must be numbers up to {LARGEST:g}")
    try:
        return _read(path, kind, dict(rest or {}), least)
    except (BodyFileError, OSError):
        raise
    except Exception as problem:  # each format's parsers have their own
        why = f"it cannot be read as {kind}: unexpected {type(problem).__name__}: {problem}"
        raise BodyFileError(str(path), None, why) from problem


def _read(path: Path, kind: str, rest: dict[str, float], least: float) -> tuple[Body, list[str]]:
    if kind == "URDF":
        from voodoo_jax.model.foreign.urdf import read_urdf

        return read_urdf(path, rest, least)
    if rest:
        raise BodyFileError(str(path), None, "joint values of the rest pose are for URDF; a mesh has its own")
    from voodoo_jax.model.foreign.skinned_mesh import read_skinned

    return read_skinned(path, least)
