"""replay.jsonl: a line for each person in each log whose results are in a folder."""

import json
import os
from collections.abc import Iterable
from pathlib import Path

from voodoo_jax.batch.log_job import remove_partials
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.storage.urls import delivered, is_url, joined, opened


def summary_name(number: int, count: int) -> str:
    """Each part of an array job has a file of its own: parts do not wait for each other."""
    return "replay.jsonl" if count == 1 else f"replay-{number}-of-{count}.jsonl"


def write_summary(outcomes: Iterable[Outcome], folder: str, name: str) -> None:
    """Writes a line of JSON for each person of each outcome, with those that the file has of other logs; in the order
    of names.

    The file appears or changes only when complete. Raises OSError.
    """
    rows: dict[str, list[dict]] = {}  # of each log
    try:
        with opened(joined(folder, name)) as stream:
            for row in [json.loads(line) for line in stream.read().decode().splitlines()]:
                rows.setdefault(row["log"], []).append(row)
    except (OSError, ValueError, KeyError, TypeError):  # none yet, or somebody else's
        pass
    rows |= {outcome.path: outcome.rows() for outcome in outcomes}
    ordered = sorted(rows, key=lambda p: (os.path.basename(p), p))
    lines = [json.dumps(row, allow_nan=False) + "\n" for log in ordered for row in rows[log]]
    if not is_url(folder):
        remove_partials(Path(folder) / name)
    with delivered(folder) as made, replacing(Path(made) / name) as partial:
        partial.write_text("".join(lines), encoding="utf-8")
