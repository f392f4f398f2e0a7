"""replay.jsonl: a line for each person in each log whose results are in a folder."""

import json
import math
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from voodoo_jax.batch.log_job import remove_partials
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.storage.urls import delivered, is_url, joined, opened


def summary_name(number: int, count: int) -> str:
    """Each part of an array job has its own file: parts do not wait for each other."""
    return "replay.jsonl" if count == 1 else f"replay-{number}-of-{count}.jsonl"


def rows_in(place: str) -> dict[str, list[dict[str, Any]]]:
    """The rows of such a file by log, if they have the form of Outcome.row; empty for a missing or foreign file."""
    found: dict[str, list[dict[str, Any]]] = {}
    with suppress(OSError, ValueError, RecursionError), opened(place) as stream:
        for line in stream.read().decode().splitlines():
            row = json.loads(line, parse_constant=float)
            if _is_row(row):
                found.setdefault(row["log"], []).append(row)
    return found


def _is_row(row: Any) -> bool:
    known = Outcome("").row()
    if not isinstance(row, dict) or set(row) != set(known):
        return False
    number = (int, float)
    kinds = {name: number if isinstance(value, number) else type(value) for name, value in known.items()}
    kinds |= {"residual_m": (int, float, type(None)), "person": int}
    finite = all(math.isfinite(value) for value in row.values() if isinstance(value, number))
    return (
        finite
        and all(isinstance(row[name], kinds[name]) for name in known)
        and all(isinstance(note, str) for note in row["notes"])
    )


def write_summary(outcomes: Iterable[Outcome], folder: str, name: str) -> None:
    """Writes a line of JSON for each person of each outcome, and keeps the lines of other logs; sorted by name.

    The file appears or changes only when complete. Raises OSError.
    """
    rows = rows_in(joined(folder, name))
    rows |= {outcome.path: outcome.rows() for outcome in outcomes}
    ordered = sorted(rows, key=lambda p: (os.path.basename(p), p))
    lines = [json.dumps(row, allow_nan=False) + "\n" for log in ordered for row in rows[log]]
    if not is_url(folder):
        remove_partials(Path(folder) / name)
    with delivered(folder) as made, replacing(Path(made) / name) as partial:
        partial.write_text("".join(lines), encoding="utf-8")
