"""Fast movements before stereo pairs: python -m experiments.stereo BODIES.npz MOTIONS LOGS

BODIES.npz as experiments/people/bodies.py writes it; MOTIONS a folder with clips of DeepMimic and of the Bandai-Namco
motion data set; LOGS a folder for the logs, which are made where they are missing. Each is tracked by the ICP tracker,
the flexible one and both; prints what comes out by log, and the numbers of the flexible tracker's confidence. Writes
stereo.md.
"""

from pathlib import Path

import numpy as np
import tyro

import voodoo_jax as vj
from experiments.common import nearest, table, write
from experiments.people.making import make
from experiments.scoreboard.promises.confidence import said_and_right
from experiments.scoreboard.promises.stereo_confidence import TRACKERS
from experiments.scoreboard.tracked import Outcome, TrackLog, errors, read_known
from experiments.stereo.takes import halves
from experiments.trust.__main__ import fitted, rank
from voodoo_jax.compile.cache_dir import users_cache
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.trackers.flexible.confidence import SLOPES, clues
from voodoo_jax.trackers.flexible.flexible_body import CENTRES, POINTS
from voodoo_jax.trackers.flexible.observed import observe
from voodoo_jax.trackers.flexible.tracker import followed
from voodoo_jax.trackers.shared.confidence import CLOSE, Trust


def cells(found: list[Outcome]) -> list[str]:
    """Of some logs: error, share within 10 cm, what was said, and how well right is told from wrong."""
    said, right = said_and_right(found)
    error, within = np.mean([o.error_cm for o in found]), np.mean([np.mean(o.error < CLOSE) for o in found])
    return [f"{error:.2f}", f"{100 * within:.1f}", f"{100 * said.mean():.1f}", f"{rank(said, right):.3f}"]


def told(log: Path) -> tuple[np.ndarray, np.ndarray]:
    """Clues [joint, clue] of a log's joints by the flexible tracker, and which are within 10 cm."""
    settings, known = vj.preset("flexible"), read_known(log.with_suffix(".truth.npz"))
    reader = open_log(log, settings.read)
    seen = observe(reader.frames(), reader.up, vj.human(), settings, reader.path)
    found = followed(vj.human(), seen, settings, reader.path, reader.fixed_frame)
    seen.close()
    if found.found is None:
        return np.zeros((0, len(SLOPES))), np.zeros(0, bool)
    point = {centre: POINTS.index(name) for name, centre in CENTRES.items()}
    each = np.full((len(found.tracks.status), len(known.names), len(SLOPES)), np.nan)
    each[found.seen.row[found.first :]] = clues(found.found)[:, [point[name] for name in known.names]]
    frame, near = nearest(known, found.tracks)
    return each[frame][near].reshape(-1, len(SLOPES)), (errors(known, found.tracks)[near] < CLOSE).ravel()


def flexible_numbers(logs: list[Path]) -> Trust:
    """The numbers of the flexible tracker's confidence, by some logs that count alike."""
    each = [(x, y, np.full(len(y), 1 / max(len(y), 1))) for x, y in map(told, logs)]
    x, y, weight = (np.concatenate(parts) for parts in zip(*each))
    return fitted(x, y, x.shape[1], weight)


@users_cache()
def main(  # 7 parameters: the command's flags
    bodies: tyro.conf.Positional[Path],
    motions: tyro.conf.Positional[Path],
    logs: tyro.conf.Positional[Path],
    only: str = "",
    fit: bool = False,
    calm: Path | None = None,
    out: Path = Path(__file__).parent,
) -> None:
    """How well fast movements are tracked by stereo pairs.

    Args:
        bodies: what bodies.py has written.
        motions: folder with humanoid3d_*.txt and dataset-1_*.bvh.
        logs: folder for the logs; those that are there are taken as they are.
        only: the logs whose names begin so.
        fit: print the numbers of the flexible tracker's confidence by the choosing half, too.
        calm: folder of further logs that these numbers are fitted to, with *.truth.npz beside each.
        out: folder for stereo.md.
    """
    logs.mkdir(parents=True, exist_ok=True)
    rows = []
    for half in halves(bodies, motions, logs):
        takes = [take for take in half.takes if take.name.startswith(only)]
        paths = [logs / f"{take.name}.mcap" for take in takes]
        for take, path in zip(takes, paths):
            if not path.exists():
                make(take, path)
        found = [[TrackLog(path, preset=name).run() for name in TRACKERS.values()] for path in paths]
        rows += [[path.stem, *(cell for one in each for cell in cells([one]))] for path, each in zip(paths, found)]
        if found:
            rows.append([f"**{half.name}**", *(cell for each in zip(*found) for cell in cells(list(each)))])
        if fit and half.name == "choosing":
            print(flexible_numbers(paths + sorted(calm.glob("*.mcap") if calm else [])))
    head = [
        f"{name}: {what}" for name in TRACKERS for what in ("cm", "within 10 cm, %", "said, %", "right above wrong")
    ]
    write(out, "stereo", table(["log", *head], rows))


if __name__ == "__main__":
    tyro.cli(main)
