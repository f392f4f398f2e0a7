"""Joint centres beside Plug-in Gait's: python -m experiments.laboratories FILE.c3d ... (needs `ezc3d`)

Vicon's software writes the bones that its model computed beside the markers: their ends are its joint centres. Each
file is converted, which leaves these out, tracked from the markers alone, and compared. Writes laboratories.md.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import ezc3d
import numpy as np
import tyro

import voodoo_jax as vj
from experiments.common import table, write
from voodoo_jax.io.convert.markers import listed
from voodoo_jax.io.convert.sources import convert
from voodoo_jax.io.convert.target import START_NS
from voodoo_jax.records.tracks import Tracks

# ends of Plug-in Gait's bones, without the side, and the joint that is there
ENDS = {"FEP": "hip", "FEO": "knee", "TIO": "talocrural", "HUP": "shoulder", "HUO": "elbow", "RAO": "radiocarpal"}


def centres(path: Path) -> tuple[float, dict[str, np.ndarray]]:
    """Frames a second, and joint centres that the model computed, [frame, 3], metres, by our names; NaN where it did
    not."""
    file = ezc3d.c3d(str(path))
    point = file["parameters"]["POINT"]
    names = [name.rpartition(":")[2] for name in listed(point, "LABELS")]
    places = np.asarray(file["data"]["points"][:3], float).transpose(2, 1, 0) / 1000
    places[(places == 0).all(2)] = np.nan
    sides = ((end, joint, side) for end, joint in ENDS.items() for side in "LR")
    found = {f"{s.lower()}_{joint}": places[:, names.index(s + end)] for end, joint, s in sides if s + end in names}
    return float(point["RATE"]["value"][0]), {j: p for j, p in found.items() if np.isfinite(p).any()}


def compared(path: Path, folder: Path) -> tuple[Tracks, dict[str, float]]:
    """A file tracked from its markers, and how far off each joint is on average, metres."""
    rate, truth = centres(path)
    log = folder / f"{path.stem}.mcap"
    convert(path, log)
    tracks = vj.track(vj.human(), vj.read_log(str(log)))
    rows = np.round((tracks.time_ns - START_NS) / 1e9 * rate).astype(int)  # frames without a marker are no frames
    away = {j: np.linalg.norm(tracks.joint(j) - places[rows], axis=1) for j, places in truth.items()}
    return tracks, {j: float(np.nanmean(d)) for j, d in away.items() if np.isfinite(d).any()}


def main(files: tyro.conf.Positional[tuple[Path, ...]], out: Path = Path(__file__).parent) -> None:
    """Joint centres beside Plug-in Gait's.

    Args:
        files: C3D files with its bones.
        out: where the table goes.
    """
    rows, every = [], []
    with TemporaryDirectory() as folder:
        for path in files:
            if not centres(path)[1]:
                print(f"{path.name}: no bones of Plug-in Gait")
                continue
            tracks, off = compared(path, Path(folder))
            both = {j: [off[s + j] for s in ("l_", "r_") if s + j in off] for j in ENDS.values()}
            every.append({j: float(np.mean(v)) for j, v in both.items() if v})
            print(f"{path.name}: {100 * np.mean(list(every[-1].values())):.1f} cm")
            cells = [f"{100 * every[-1][j]:.1f}" if j in every[-1] else "" for j in both]
            mean = 100 * float(np.mean(list(every[-1].values())))
            rows.append(
                [path.stem, str(len(tracks.time_ns)), f"{100 * tracks.tracked.mean():.0f}", *cells, f"{mean:.1f}"]
            )
    means = [float(np.mean([e[j] for e in every if j in e] or [np.nan])) for j in ENDS.values()]
    total = float(np.mean([np.mean(list(e.values())) for e in every] or [np.nan]))
    rows.append(["all", "", "", *(f"{100 * m:.1f}" for m in means), f"{100 * total:.1f}"])
    write(out, "laboratories", table(["file", "frames", "tracked, %", *ENDS.values(), "mean, cm"], rows))


if __name__ == "__main__":
    tyro.cli(main)
