"""Weights of bands and measurements tuned on one half of the people, scored on the other:
python -m experiments.fit.weights RECORDINGS

Fitted to the truth's joint centres, every person with a body of its own, bands and weights in common (`free`); then
both halves are tracked with what was found. Priors are narrow: a fit judges frames that were tracked well, and what a
track needs where it is wrong they do not show. Writes weights.md.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import MEAN_HEAD, Log, Score, halves, human, load_logs, log_files, mean_row, score, table, write
from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.fit import Seen, fit_tracked
from voodoo_jax.fitting.folds import with_bands
from voodoo_jax.fitting.frames import Truth
from voodoo_jax.model.body import Body


def tracked(logs: list[Log], body: Body, settings: Settings) -> list[Score]:
    """How well the logs are tracked."""
    return [score(log, log.track(body, settings)) for log in tqdm(logs, "track", leave=False, disable=None)]


def main(
    recordings: tyro.conf.Positional[Path],
    free: tuple[str, ...] = ("bands.*.weight", "measurement weights"),
    every: int = 1,
    frames: int = 0,
    fit_options: FitSettings = FitSettings(frames=16, persons="each", looseness=0.3),  # noqa: B008  frozen
    out: Path = Path(__file__).parent,
) -> None:
    """Weights tuned on one half of the people, scored on the other.

    Args:
        recordings: folder with *.mcap and *.truth.npz of at least two people.
        free: what is tuned.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        fit_options: the fit's.
        out: folder for weights.md.
    """
    files = log_files(recordings)[::every]
    body, parts = human(), halves(files)
    if not all(parts):
        raise SystemExit(f"{recordings} has recordings of one person only: there are no halves.")
    logs = dict(zip(files, load_logs(recordings, body, Settings(), every, frames)))
    own = [[logs[f] for f in part] for part in parts]
    before = [tracked(some, body, Settings()) for some in own]
    rows = [[f"default, half {k}", *mean_row(found)] for k, found in zip("AB", before)]
    numbers = []
    for k in (0, 1):
        seen = [Seen(log.track(body, Settings()), log.people, log.scene) for log in own[k]]
        truths = [Truth(log.stamps, log.names, log.joints) for log in own[k]]
        found = fit_tracked(seen, Settings(), replace(fit_options, free=free), truths)
        numbers.append(dict(zip(found.names, np.exp(found.x))))
        new = with_bands(body, found.starts[0], found.fitted[0])
        rows += [
            [f"tuned on {'AB'[k]}, half {'AB'[half]}", *mean_row(tracked(own[half], new, found.tuned))]
            for half in (k, 1 - k)
        ]
        tqdm.write("\n".join(" ".join(row) for row in rows[-2:]))
    weights = [
        [name, *(f"{n.get(name, 1.0):.2f}" for n in numbers)] for name in dict.fromkeys([*numbers[0], *numbers[1]])
    ]
    people = f"A: {len(parts[0])}, B: {len(parts[1])} recordings; no person is in both.\n\n"
    text = (
        people + table(["", *MEAN_HEAD], rows) + "\nFactors that were found:\n\n" + table(["", "on A", "on B"], weights)
    )
    write(out, "weights", text)


if __name__ == "__main__":
    tyro.cli(main)
