"""replay.jsonl: one line for each log whose results are in a folder."""

import json
import os
from collections.abc import Iterable
from pathlib import Path

from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.storage.urls import delivered, joined, opened


def summary_name(number: int, count: int) -> str:
    """Each part of an array job has a file of its own: parts do not wait for each other."""
    return "replay.jsonl" if count == 1 else f"replay-{number}-of-{count}.jsonl"


def write_summary(outcomes: Iterable[Outcome], folder: str, name: str) -> None:
    """Writes a line of JSON for each outcome, with those that the file has of other logs; in the order of names.

    The file appears or changes only when complete. Raises OSError.
    """
    rows = {}
    try:
        with opened(joined(folder, name)) as stream:
            found = [json.loads(line) for line in stream.read().decode().splitlines()]
            rows = {row["log"]: row for row in found}
    except (OSError, ValueError, KeyError, TypeError):  # none yet, or somebody else's
        pass
    rows |= {outcome.path: outcome.row() for outcome in outcomes}
    lines = [
        json.dumps(rows[log], allow_nan=False) + "\n" for log in sorted(rows, key=lambda p: (os.path.basename(p), p))
    ]
    with delivered(folder) as made, replacing(Path(made) / name) as partial:
        partial.write_text("".join(lines), encoding="utf-8")
