"""Named points over time in tables (CSV): exports of Motive, and any with columns NAME_x, NAME_y, NAME_z.

Motive (OptiTrack): a first line of `Format Version` and so on, then lines of types, names and axes, then a line for
each frame; its labelled markers are used, or without any the origins of its bones. Y is up. Other tables (FreeMoCap,
pandas): a line of names, then one for each frame, with a column of times in seconds or at a given rate.
"""

import csv
import re
from io import StringIO
from pathlib import Path

import numpy as np

from voodoo_jax.io.convert.markers import METRES, unit_by_size, unit_name, write_markers
from voodoo_jax.io.convert.target import ConvertError, content
from voodoo_jax.storage.guarded import Answer

USUAL_HZ = 30.0  # of most cameras, where neither the file nor a user says it
AXIS = re.compile(r"(.+?)[ _.:\-\[(]*([xyz])\W*(?:mm|cm|m)?\W*", re.IGNORECASE)
TIMES = re.compile(r"(frame_?)?(time|timestamps?|seconds|t)(\W*\(?(s|sec|seconds)\)?)?(_s|_sec)?", re.IGNORECASE)


def convert(source: Path, target: Answer, rate: float = 0.0) -> list[str]:
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
    return np.array([[_number(v) for v in (row + [""] * width)[:width]] for row in rows], float).reshape(-1, width)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _points(table: np.ndarray, columns: list[list[int]]) -> np.ndarray:
    points = table[:, columns]
    return np.where((points == 0).all(2, keepdims=True), np.nan, points)
