"""Named points over time, in the axes of the file, metres, from one second on: C3D, TRC, and tables (CSV).

C3D files are read by ezc3d, and by py-c3d what that does not support (MIPS, parameters of other types). Tables are
exports of Motive, and any with columns NAME_x, NAME_y, NAME_z. Motive (OptiTrack): a first line of `Format Version` and
so on, then lines of types, names and axes, then a line for each frame; its labelled markers are used, or without any
the origins of its bones. Y is up. Other tables (FreeMoCap, pandas): a line of names, then one for each frame, with a
column of times in seconds or at a given rate.
"""

import csv
import re
import warnings
from collections import Counter
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from voodoo_jax.io.convert.target import START_NS, ConvertError, check_points, content, new_log, putter, scene_of_points
from voodoo_jax.storage.guarded import Answer

USUAL_HZ = 30.0  # of most cameras, where neither the file nor a user says it
AXIS = re.compile(r"(.+?)[ _.:\-\[(]*([xyz])\W*(?:mm|cm|m)?\W*", re.IGNORECASE)
TIMES = re.compile(r"(frame_?)?(time|timestamps?|seconds|t)(\W*\(?(s|sec|seconds)\)?)?(_s|_sec)?", re.IGNORECASE)
TOPIC, FRAME = "/markers", "lab"
QUANTITIES = "ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS"  # parameters of POINT that list what is no place
PLACES = "MARKERS", "MODELED_MARKERS"  # that list what is one
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "dm": 0.1, "in": 0.0254}
WORDS = {
    "m": ("meters", "metres"), "mm": ("millimeters", "millimetres"), "cm": ("centimeters", "centimetres"),
    "dm": ("decimeters", "decimetres"), "in": ("inches",),
}  # fmt: skip
SHORTEST = 4  # letters of a word for a unit: the format's first programs kept so many of each name


def convert_table(source: Path, target: Answer, rate: float = 0.0) -> list[str]:
    """Points of a table; empty fields and NaN are missing. Raises ConvertError, OSError."""
    with StringIO(content(source).decode("utf-8-sig", "replace"), newline="") as stream:
        rows = [row for row in csv.reader(stream) if row]
    try:
        if rows and rows[0][0].strip() == "Format Version":
            return _motive(source, target, rows)
        return _table(source, target, rows, rate)
    except (ValueError, IndexError) as problem:
        if isinstance(problem, ConvertError):
            raise
        raise ConvertError(f"'{source}' cannot be read as a table of points: {problem}") from problem


def _motive(source: Path, target: Answer, rows: list[list[str]]) -> list[str]:
    head = dict(zip(rows[0][::2], rows[0][1::2]))
    above = next(i for i, row in enumerate(rows) if row[0].strip() == "Frame")
    kinds, names, what = rows[1], rows[2], rows[above - 1]  # between them are numbers and parents
    time = next(k for k, word in enumerate(rows[above]) if word.startswith("Time"))
    place = [k for k in range(time + 1, len(what)) if what[k].strip() == "Position"]
    groups = [place[i : i + 3] for i in range(0, len(place), 3)]
    kind = lambda g: kinds[g[0]].strip().lower()  # noqa: E731
    marked = [g for g in groups if kind(g).endswith("marker")]
    named = [g for g in marked if not names[g[0]].strip().lower().startswith("unlabeled")]
    # of what was measured and what was solved for it the first
    single = {names[g[0]].strip(): g for g in sorted(named or marked, key=lambda g: kind(g) == "marker")}
    chosen = list(single.values()) or [g for g in groups if kind(g) == "bone"]
    if not chosen:
        raise ConvertError(f"'{source}' has neither markers nor bones")
    table = _numbers(rows[above + 1 :], len(what))
    unit = unit_name(head.get("Length Units", "")) or unit_by_size(_points(table, chosen), source, "")
    labels = [names[g[0]].strip() for g in chosen]
    write_markers(target, source, labels, _points(table, chosen) * METRES[unit], table[:, time], "y")
    return []


def _table(source: Path, target: Answer, rows: list[list[str]], rate: float) -> list[str]:
    columns: dict[str, dict[str, int]] = {}
    for k, name in enumerate(rows[0]):
        if found := AXIS.fullmatch(name.strip()):
            columns.setdefault(found[1], {}).setdefault(found[2].lower(), k)
    groups = {name: [axes[a] for a in "xyz"] for name, axes in columns.items() if len(axes) == 3}
    if not groups:
        raise ConvertError(f"'{source}' has no columns NAME_x, NAME_y, NAME_z, and is no export of Motive")
    table, notes = _numbers(rows[1:], len(rows[0])), []
    points = _points(table, list(groups.values()))
    unit = unit_by_size(points, source, "")
    if unit != "m":
        notes.append(f"'{source}' names no unit: judged by size, it is {unit}")
    time = next((k for k, name in enumerate(rows[0]) if TIMES.fullmatch(name.strip())), None)
    if time is not None and not rate and np.isfinite(table[:, time]).all():
        seconds = table[:, time]
    else:
        seconds = np.arange(len(table)) / (rate or USUAL_HZ)
        if not rate:
            notes.append(f"'{source}' has no times: {USUAL_HZ:g} frames a second are assumed (to override: --rate)")
    write_markers(target, source, list(groups), points * METRES[unit], seconds, "")
    return notes


def _numbers(rows: list[list[str]], width: int) -> np.ndarray:
    """[row, column]; NaN where there is no number."""
    return np.array([[_number_or_nan(v) for v in (row + [""] * width)[:width]] for row in rows], float).reshape(
        -1, width
    )


def _number_or_nan(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _points(table: np.ndarray, columns: list[list[int]]) -> np.ndarray:
    points = table[:, columns]
    return np.where((points == 0).all(2, keepdims=True), np.nan, points)


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


def convert_c3d(source: Path, target: Answer) -> list[str]:
    """Points of a C3D file; those with a negative residual are missing. Raises ConvertError, OSError."""
    point, points, missing, rate = points_of(source)
    names = _names(point)[: points.shape[1]]
    check_points(len(names), len(points))
    points, missing = points[:, : len(names)], missing[:, : len(names)]
    missing = missing | ~np.isfinite(points).all(2) | (points == 0).all(2)
    points = np.where(missing[..., None], np.nan, points)
    computed = _computed(point, names)
    kept = [k for k, name in enumerate(names) if name not in computed]
    left_out = len(names) - len(kept)
    names, points, notes = [names[k] for k in kept], points[:, kept], []
    if left_out:
        notes.append(
            f"{left_out} computed channels were left out (angles, forces, axes of bones): they are not markers"
        )
    stated = next(iter(listed(point, "UNITS")), "")
    if (unit := unit_name(stated)) is None:
        unit = unit_by_size(points, source, stated)
        notes.append(f"'{source}' names {_no_unit(stated)}: judged by size, it is {unit}")
    write_markers(
        target,
        source,
        names,
        points * METRES[unit],
        np.arange(len(points)) / rate if rate > 0 else np.zeros(len(points)),
        _upwards(point),
    )
    return notes


def listed(point: dict[str, Any], key: str) -> list[str]:
    """A parameter of the group POINT, continued in `key`2, `key`3, ...: each of these has up to 255 names."""
    parts = {int(found[1] or 1): k for k in point if (found := re.fullmatch(f"{key}(\\d*)", k))}
    return [_letters(str(name)).strip() for _, k in sorted(parts.items()) for name in point[k]["value"]]


def _letters(text: str) -> str:
    """A text whose bytes were not UTF-8, as Latin-1."""
    data = text.encode("utf-8", "surrogateescape")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _names(point: dict[str, Any]) -> list[str]:
    """Of all points. Names of four letters may stand for several points: those are named by their description."""
    names, described = listed(point, "LABELS"), listed(point, "DESCRIPTIONS")
    often, uses = Counter(names), Counter(described)
    described += [""] * (len(names) - len(described))
    return [d if often[n] > 1 and d and uses[d] == 1 else n for n, d in zip(names, described)]


def _computed(point: dict[str, Any], names: list[str]) -> set[str]:
    """What stands among the points and is none: what Vicon's software lists under the name of a quantity, and its
    bones, of which each is four points, the origin and an end of each axis: LFEO, LFEA, LFEL, LFEP."""
    quantities = listed(point, "TYPE_GROUPS")[::2] or list(QUANTITIES)
    derived = {name for key in quantities if key not in PLACES for name in listed(point, key)}
    ends = Counter(name[:-1] for name in {*names} if re.fullmatch(r"(.*:)?[A-Z]{3}[OALP]", name))
    bones = {bone + end for bone, count in ends.items() if count == 4 for end in "OALP"}
    return derived | bones


def unit_name(text: str) -> str | None:
    """A unit's short name, from itself or from its full name, which may be truncated ("mete"); None if unknown."""
    text = text.strip().lower().rstrip(".")
    if text in METRES:
        return text
    words = ((word, unit) for unit, forms in WORDS.items() for word in forms)
    return next((unit for word, unit in words if len(text) >= SHORTEST and word.startswith(text)), None)


def _no_unit(stated: str) -> str:
    return f"the unit '{stated}', which is none," if stated else "no unit"


def unit_by_size(points: np.ndarray, source: Path, stated: str) -> str:
    """The unit in which the extent of a frame's points is plausible for a recording of markers."""
    seen = points[np.isfinite(points).all(2).sum(1) >= 3]
    extent = np.median(np.linalg.norm(np.nanmax(seen, 1) - np.nanmin(seen, 1), axis=1)) if len(seen) else np.nan
    for unit in ("mm", "m", "cm"):  # by how often they are meant
        if 0.3 < extent * METRES[unit] < 10:
            return unit
    raise ConvertError(f"'{source}' names {_no_unit(stated)} and its points are not as large as a body in mm, cm or m")


def convert_trc(source: Path, target: Answer) -> list[str]:
    """Points of a TRC file; empty fields and NaN are missing. Raises ConvertError, OSError."""
    lines = content(source).decode("utf-8", "replace").splitlines()
    try:
        header = dict(zip(*_fields(lines[1], lines[2])))
        names = [name.strip() for name in lines[3].split("\t")[2:] if name.strip()]
        if (unit := unit_name(header["Units"].strip())) is None:
            raise ConvertError(f"'{source}' has the unit '{header['Units'].strip()}'; known are {', '.join(METRES)}")
        rows = [line.split("\t") for line in lines[5:] if line.strip() and line.split("\t")[0].strip().isdigit()]
        width = 2 + 3 * len(names)
        check_points(len(names), len(rows))
        padded = [(row + [""] * width)[:width] for row in rows]
        table = np.array([[float(v) if v.strip() else np.nan for v in row] for row in padded]).reshape(-1, width)
    except ConvertError:
        raise
    except (IndexError, KeyError, ValueError) as problem:
        raise ConvertError(f"'{source}' cannot be read as TRC: {type(problem).__name__}: {problem}") from problem
    if not names or not np.isfinite(table[:, 1]).all():
        raise ConvertError(f"'{source}' cannot be read as TRC: it names no marker, or rows have no time")
    # by OpenSim's convention y is up
    write_markers(target, source, names, table[:, 2:].reshape(len(table), -1, 3) * METRES[unit], table[:, 1], "y")
    return []


def _fields(names: str, values: str) -> tuple[list[str], list[str]]:
    """Of a header: by white space, for some programs put two tabs between values; by tabs where a value is missing."""
    by_space = names.split(), values.split()
    return by_space if len(by_space[0]) == len(by_space[1]) else (names.split("\t"), values.split("\t"))


def _upwards(point: dict[str, Any]) -> str:
    """The axis that stands upright on a screen; "" where the file does not say it."""
    axis = next(iter(listed(point, "Y_SCREEN")), "").lower().lstrip("+")
    return axis if re.fullmatch("-?[xyz]", axis) else ""


# 6 parameters: what there is, from where and to where
def write_markers(
    target: Answer, source: Path, names: list[str], points: np.ndarray, seconds: np.ndarray, up: str
) -> None:
    """Writes named points [frame, point, 3], metres, at times in seconds from any zero; `up` as in read.up.

    Raises ConvertError, OSError.
    """
    if not len(points) or not np.isfinite(points).any():
        raise ConvertError(f"'{source}' has no point")
    stamps = START_NS + np.round((seconds - seconds[0]) * 1e9).astype(np.int64)
    with new_log(target) as writer:
        put = putter(writer, up)
        for stamp, places in zip(stamps.tolist(), points):
            put(TOPIC, stamp, scene_of_points(names, places, stamp, FRAME))
