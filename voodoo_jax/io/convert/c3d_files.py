"""Reads C3D files by ezc3d, and by py-c3d what that does not support (MIPS, parameters of other types)."""

import warnings
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from voodoo_jax.io.convert.target import ConvertError, content


class Points(NamedTuple):
    """The points of a file, in its unit, and its group POINT: {parameter: {"value": [...]}}."""

    group: dict[str, Any]
    places: Float[np.ndarray, "frame point 3"]
    missing: Bool[np.ndarray, "frame point"]
    rate: float


def points_of(source: Path) -> Points:
    """The points of a file. Raises ConvertError, with the message of ezc3d."""
    try:
        import ezc3d  # noqa: F401
    except ImportError as problem:
        raise ConvertError('C3D files need ezc3d: pip install "voodoo_jax[c3d]"') from problem
    try:
        return _by_ezc3d(source)
    except (OSError, RuntimeError, KeyError, IndexError, ValueError, SystemError) as problem:
        try:
            found = _by_c3d(source)
        except Exception:  # it has errors of all kinds; the other's say more
            raise ConvertError(f"'{source}' cannot be read as C3D; ezc3d says: {problem}") from problem
        return found


def _by_ezc3d(source: Path) -> Points:
    import ezc3d

    file = ezc3d.c3d(str(source))
    point = file["parameters"]["POINT"]
    places = np.asarray(file["data"]["points"][:3], float).transpose(2, 1, 0)
    residual = np.asarray(file["data"]["meta_points"]["residuals"], float)[0].T
    return Points(point, places, residual < 0, float(point["RATE"]["value"][0]))


def _by_c3d(source: Path) -> Points:
    import c3d

    with BytesIO(content(source)) as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reader = c3d.Reader(stream)
        frames = [np.array(points) for _, points, _ in reader.read_frames(copy=True)]
        points: Any = reader.get("POINT")
        group = {key.upper(): {"value": _values(value)} for key, value in points.param_items()}
        rate = float(reader.point_rate)
    table = np.array(frames, float).reshape(len(frames), -1, 5)
    return Points(group, table[:, :, :3], table[:, :, 3] < 0, rate)


def _values(parameter: Any) -> list[Any]:
    """A parameter's texts, with bytes that are not UTF-8 as ezc3d gives them."""
    if parameter.bytes_per_element > 0:  # numbers, which nobody asks for
        return []
    width = parameter.dimensions[0] if parameter.dimensions else parameter.total_bytes
    data = bytes(parameter.bytes)
    return [data[at : at + width].decode("utf-8", "surrogateescape") for at in range(0, len(data), max(width, 1))]
