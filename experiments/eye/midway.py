"""`--online` begun at random frames of recordings: who is turned in the first frame and a second later, how far off.

python -m experiments.eye.midway RECORDINGS OUT.json
"""

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro

import voodoo_jax as vj
from experiments.common import log_files
from experiments.scoreboard.tracked import Known, read_known
from voodoo_jax.records.recording import NO_PAIRS, NO_RAYS

SECONDS = 1.5  # of the log from the first frame on
SEED = 60
SIDES = ("shoulder", "hip")


def turned(joints: np.ndarray, truth: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
    """[...] Whether the sides of the trunk are exchanged: the facing is wrong by more than 90 degrees."""

    def across(some: np.ndarray) -> np.ndarray:
        return np.sum([some[..., names.index(f"l_{s}"), :2] - some[..., names.index(f"r_{s}"), :2] for s in SIDES], 0)

    return np.sum(across(joints) * across(truth), -1) < 0


def begun_at(recording: vj.Recording, first: int, known: Known, settings: vj.Settings) -> dict:
    """A row: the tracker begun in frame `first` beside the truth."""
    times = np.array([f.time_ns for f in recording.frames])
    end = int(np.searchsorted(times, times[first] + SECONDS * 1e9))
    before = time.process_time()
    tracks = vj.track(vj.human(), replace(recording, frames=recording.frames[first:end]), settings)
    spent = time.process_time() - before
    centres = tracks.body.topology.centres
    names = tuple(n for n in known.names if n in centres)
    mine = tracks.joints[:, [centres.index(n) for n in names]].astype(float)
    nearest = np.abs(known.stamps[None] - tracks.time_ns[:, None]).argmin(1)
    truth = known.joints[nearest][:, [known.names.index(n) for n in names]]
    away = np.linalg.norm(mine - truth, axis=-1).mean(1)
    there = np.flatnonzero(tracks.tracked & np.isfinite(away))
    row = dict(frame=first, seconds=spent, share=len(there) / max(len(away), 1))
    if not len(there):
        return row
    later = there[there >= np.searchsorted(tracks.time_ns, tracks.time_ns[there[0]] + 1_000_000_000)]
    back = turned(mine, truth, names)
    row |= dict(waited=int(there[0]), cm=100 * away[there[0]], turned=bool(back[there[0]]))
    row |= dict(names=names, joints=mine[there[0]].tolist(), truth=truth[there[0]].tolist())
    if len(later):
        row |= dict(cm_later=100 * away[later[0]], turned_later=bool(back[later[0]]))
    return row


def main(
    recordings: tyro.conf.Positional[Path],
    out: tyro.conf.Positional[Path],
    count: int = 20,
    every: int = 1,
    depth_only: bool = False,
    skip: int = 0,
) -> None:
    """Who is turned when `--online` begins midway.

    Args:
        recordings: folder of logs with a truth beside them.
        out: *.json for the rows.
        count: random frames of each log.
        every: of these one of so many is begun at.
        depth_only: without the log's features.
        skip: logs that are left out at the beginning; the frames of the others stay the same.
    """
    rng, settings, rows = np.random.default_rng(SEED), vj.online(vj.preset("default")), {}
    for number, path in enumerate(log_files(recordings)):
        known, log = read_known(path.with_suffix(".truth.npz")), vj.read_log(path)
        stamps = [f.time_ns for f in log.frames]
        last = int(np.searchsorted(stamps, stamps[-1] - SECONDS * 1e9))
        at = np.sort(rng.choice(last, min(count, last), replace=False))[::every]
        if number < skip:
            continue
        if depth_only:
            log = replace(log, frames=tuple(replace(f, rays=NO_RAYS, pairs=NO_PAIRS) for f in log.frames))
        rows[path.stem] = [begun_at(log, int(k), known, settings) for k in at]
        print(path.stem, row_of(rows[path.stem]), flush=True)
        out.write_text(json.dumps(rows, indent=0))
    print("all", row_of([row for some in rows.values() for row in some]))


def row_of(rows: list[dict]) -> str:
    """Figures of some rows: starts, found, turned first and later, cm first and later, processor seconds."""

    def mean(name: str) -> float:
        some = [row[name] for row in rows if name in row]
        return float(np.mean(some)) if some else float("nan")

    return (
        f"n {len(rows)} found {100 * np.mean(['cm' in r for r in rows]):.1f} % turned {100 * mean('turned'):.1f} % "
        f"later {100 * mean('turned_later'):.1f} % cm {mean('cm'):.1f} later {mean('cm_later'):.1f} "
        f"frames waited {mean('waited'):.1f} s {mean('seconds'):.2f}"
    )


if __name__ == "__main__":
    tyro.cli(main)
