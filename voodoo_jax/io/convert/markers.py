"""C3D and TRC: named points over time, in the axes of the file, metres, from one second on."""

from pathlib import Path

import numpy as np

from voodoo_jax.io.convert.target import START_NS, ConvertError, new_log, putter, scene_of_points

TOPIC, FRAME = "/markers", "lab"
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "dm": 0.1, "in": 0.0254, "inches": 0.0254}


def convert_c3d(source: Path, target: Path) -> list[str]:
    """Points of a C3D file; those with a negative residual are missing. Raises ConvertError, OSError."""
    try:
        import ezc3d
    except ImportError as problem:
        raise ConvertError('C3D files need ezc3d: pip install "voodoo_jax[c3d]"') from problem
    try:
        file = ezc3d.c3d(str(source))
        point = file["parameters"]["POINT"]
        names = [name for key in sorted(k for k in point if k.startswith("LABELS")) for name in point[key]["value"]]
        rate = float(point["RATE"]["value"][0])
        unit = _unit(str(point["UNITS"]["value"][0]) if point.get("UNITS", {}).get("value") else "", source)
        points = np.asarray(file["data"]["points"][:3], float).transpose(2, 1, 0) * unit
        residual = np.asarray(file["data"]["meta_points"]["residuals"], float)[0].T
    except (OSError, RuntimeError, KeyError, IndexError, ValueError) as problem:
        if isinstance(problem, ConvertError):
            raise
        raise ConvertError(f"'{source}' cannot be read as C3D: {problem}") from problem
    names = names[: points.shape[1]]
    missing = (residual < 0) | ~np.isfinite(points).all(2) | (points == 0).all(2)
    points = np.where(missing[:, : points.shape[1], None], np.nan, points)
    _write(target, source, names, points, np.arange(len(points)) / rate if rate > 0 else np.zeros(len(points)))
    return []


def convert_trc(source: Path, target: Path) -> list[str]:
    """Points of a TRC file; empty fields and NaN are missing. Raises ConvertError, OSError."""
    lines = source.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        header = dict(zip(lines[1].split("\t"), lines[2].split("\t")))
        names = [name.strip() for name in lines[3].split("\t")[2:] if name.strip()]
        unit = _unit(header["Units"].strip(), source)
        rows = [line.split("\t") for line in lines[5:] if line.strip() and line.split("\t")[0].strip().isdigit()]
        width = 2 + 3 * len(names)
        table = np.array([[_number(v) for v in (row + [""] * width)[:width]] for row in rows]).reshape(-1, width)
    except ConvertError:
        raise
    except (IndexError, KeyError, ValueError) as problem:
        raise ConvertError(f"'{source}' cannot be read as TRC: {type(problem).__name__}: {problem}") from problem
    if not names or not np.isfinite(table[:, 1]).all():
        raise ConvertError(f"'{source}' cannot be read as TRC: it names no marker, or rows have no time")
    _write(target, source, names, table[:, 2:].reshape(len(table), -1, 3) * unit, table[:, 1])
    return []


def _number(text: str) -> float:
    return float(text) if text.strip() else np.nan


def _unit(name: str, source: Path) -> float:
    if name.strip().lower() not in METRES:
        raise ConvertError(f"'{source}' has the unit '{name}'; known are {', '.join(METRES)}")
    return METRES[name.strip().lower()]


def _write(target: Path, source: Path, names: list[str], points: np.ndarray, seconds: np.ndarray) -> None:
    if not len(points) or not np.isfinite(points).any():
        raise ConvertError(f"'{source}' has no point")
    stamps = START_NS + np.round((seconds - seconds[0]) * 1e9).astype(np.int64)
    with new_log(target) as writer:
        put = putter(writer)
        for stamp, places in zip(stamps.tolist(), points):
            put(TOPIC, stamp, scene_of_points(names, places, stamp, FRAME))
