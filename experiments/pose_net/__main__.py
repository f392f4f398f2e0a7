"""What a pose net's key points and depth give, alone and together: python -m experiments.pose_net RECORDINGS

Needs the extra [pose] and recordings with colour images. Each is tracked by depth alone and with the key points as
lines of sight; the net alone is lifted: every key point to the depth that is measured there. Writes pose_net.md.
"""

from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from experiments.common import SKIP, errors, human, load_log, log_files, score, scored, table, without_features, write
from voodoo_jax.config.options import ReadSettings, Settings
from voodoo_jax.io.pose_rays import NAMES
from voodoo_jax.model.joint_names import row_of
from voodoo_jax.records.observation import BodyObservation

NEAR = 0.04  # metres from the line of sight: a forearm's radius
FRAMES = 5  # over which the median of a lifted key point is taken


def lifted(people: list[BodyObservation]) -> np.ndarray:
    """[frame, name, 3] Each key point where its line of sight meets the nearest fifth of the body's points around it,
    metres; the median of five frames, NaN where there is none."""
    out = np.full((len(people), len(NAMES), 3), np.nan)
    for k, f in enumerate(people):
        for name, origin, direction in zip(f.rays.names, f.rays.origins, f.rays.directions):
            to = f.points - origin
            along = to @ direction
            there = along[np.linalg.norm(to - along[:, None] * direction, axis=1) < NEAR]
            if len(there) >= 5:
                near = np.sort(there)[: max(5, len(there) // 5)]
                out[k, NAMES.index(name)] = origin + np.median(near) * direction
    half = FRAMES // 2
    smooth = np.full(out.shape, np.nan)
    for k in range(len(out)):
        part = out[max(0, k - half) : k + half + 1]
        seen = np.isfinite(part[..., 0]).any(0)
        smooth[k, seen] = np.nanmedian(part[:, seen], axis=0)
    return smooth


def main(recordings: tyro.conf.Positional[Path], every: int = 1, net: str = "mediapipe",
         out: Path = Path(__file__).parent) -> None:  # fmt: skip
    """What a pose net's key points and depth give, alone and together.

    Args:
        recordings: folder with *.mcap and *.truth.npz; logs with colour images.
        every: take every N-th recording.
        net: as --read.pose-net.
        out: folder for pose_net.md.
    """
    body, settings = human(), Settings(read=ReadSettings(pose_net=net))
    rows, all_figures = [], []
    for path in tqdm(log_files(recordings)[::every], "recordings", leave=False, disable=None):
        log = load_log(path, body, settings)
        joints = np.array([row_of(log.names, name) for name in NAMES], int)  # all of them have a truth
        figures = []
        for people in (without_features(log.people), log.people):
            tracks = log.track(body, settings, people)
            found = score(log, tracks)
            ten = 100 * errors(log, tracks)[scored(log)][:, joints]
            figures.append((found.error_cm, found.within, float(np.nanmean(ten)), 100 * float(np.nanmean(ten < 10))))
        stamps = np.array([f.time_ns for f in log.people])
        frame = np.abs(stamps[None] - log.stamps[scored(log)][:, None]).argmin(1)
        off = 100 * np.linalg.norm(lifted(log.people)[frame] - log.joints[scored(log)][:, joints], axis=-1)
        alone = np.where(np.isfinite(off), off, 100.0)  # no answer counts as a metre, as for tracks
        seen = float(np.isfinite(off).mean())
        figures.append((float(np.nanmean(off)), 100 * seen, float(alone.mean()), 100 * float((alone < 10).mean())))
        all_figures.append(figures)
        rows.append([log.name, *cells(np.array(figures))])
        tqdm.write(" ".join(rows[-1]))
    rows.append(["**mean**", *cells(np.mean(all_figures, 0))])
    head = ["recording", "depth: cm", "within 10 cm, %", "depth and net: cm", "within 10 cm, %",
            "ten joints, depth: cm", "net lifted: cm where it says something (% of the time)", "both: cm",
            "within 10 cm, %: depth", "net lifted", "both"]  # fmt: skip
    text = table(head, rows)
    write(out, "pose_net", f"{text}\nWithout the first {SKIP:g} s; the ten joints are {', '.join(NAMES)}.\n")


def cells(f: np.ndarray) -> list[str]:
    """The row of one recording; `f` rows: depth, both, net alone."""
    depth, both, alone = f
    return [
        *(f"{x:.{d}f}" for row in (depth, both) for x, d in zip(row[:2], (2, 1))),
        f"{depth[2]:.2f}", f"{alone[0]:.2f} ({alone[1]:.0f})", f"{both[2]:.2f}",
        *(f"{x:.1f}" for x in (depth[3], alone[3], both[3])),
    ]  # fmt: skip


if __name__ == "__main__":
    tyro.cli(main)
