"""How much of the error is constant in a log, and what each oracle removes: python -m experiments.offsets LOGS

Every log is tracked with nothing given, and again with the person's true stature and true lengths. True positions are
used to analyse only. Writes offsets.md.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Bool, Float
from tqdm import tqdm

from experiments.common import DEMO, Log, human, load_dims, load_log, log_files, nearest, scored, table, write
from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body, scaled, segment_lengths, with_proportions
from voodoo_jax.records.tracks import Tracks

LIMB_OF = {"upper_arm": "upper_arm", "forearm": "forearm", "thigh": "thigh", "shank": "shank"}  # segment -> limb
Away = Float[np.ndarray, "time joint 3"]


@dataclass(frozen=True)
class Offsets:
    """What is constant in one log."""

    person: float  # true stature, metres: tells people apart
    away: Away  # truth less tracks in the body's heading (forward, left, up), metres

    @property
    def constant(self) -> Float[np.ndarray, "joint 3"]:
        """Median over the log."""
        return np.nanmedian(self.away, 0)

    def error_cm(self, less: Float[np.ndarray, "joint 3"] | float = 0.0) -> float:
        """Mean joint error where an offset is taken out, cm."""
        return 100 * float(np.nanmean(np.linalg.norm(self.away - less, axis=-1)))


def heading(joints: Away, names: tuple[str, ...]) -> Float[np.ndarray, "time 3 3"]:
    """Forward, left and up (rows) of a body whose shoulders and hips are known; z is up."""
    at = {name: joints[:, k] for k, name in enumerate(names)}
    left = at["l_shoulder"] - at["r_shoulder"] + at["l_hip"] - at["r_hip"]
    left[:, 2] = 0
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    up = np.broadcast_to([0.0, 0.0, 1.0], left.shape)
    return np.stack([np.cross(left, up), left, up], 1)


def offsets(log: Log, tracks: Tracks, person: float) -> Offsets:
    """Tracks beside the truth, in the frames that are scored and have both."""
    frame, near = nearest(log, tracks)
    found = tracks.joints[frame][:, [tracks.body.topology.centres.index(n) for n in log.names]].astype(float)
    both: Bool[np.ndarray, " time"] = scored(log) & near & np.isfinite(found).all((1, 2))
    found, truth = found[both], log.joints[both]
    return Offsets(person, np.einsum("tab,tjb->tja", heading(found, log.names), truth - found))


def true_lengths(body: Body, dims: dict[str, float]) -> Body:
    """The body with a person's stature and lengths of segments."""
    body = scaled(body, dims["stature"])
    now = segment_lengths(body)
    longer = {f"{side}_{limb}": dims[name] / now[name] for name, limb in LIMB_OF.items() for side in "lr"}
    return with_proportions(body, longer)


def rows(found: list[Offsets]) -> list[list[str]]:
    """Mean joint error with offsets taken out that are known more and more closely."""
    people = sorted({o.person for o in found})
    mean = lambda some: np.mean([np.mean([o.constant for o in found if o.person == p], 0) for p in some], 0)  # noqa: E731

    def others(one: Offsets) -> Float[np.ndarray, "joint 3"] | float:
        rest = [p for p in people if p != one.person]
        return mean(rest) if rest else 0.0

    def own(one: Offsets) -> Float[np.ndarray, "joint 3"] | None:
        rest = [o.constant for o in found if o.person == one.person and o is not one]
        return np.mean(rest, 0) if rest else None

    cases = {
        "as tracked": lambda o: 0.0,
        "less the mean offset of the other people": others,
        "less the person's own, of that person's other logs": own,
        "less the log's own": lambda o: o.constant,
    }
    lines = []
    for name, less in cases.items():
        some = [o.error_cm(known) for o in found if (known := less(o)) is not None]
        lines.append([name, str(len(some)), f"{np.mean(some):.2f}" if some else "-"])
    return lines


def joint_rows(found: list[Offsets], names: tuple[str, ...]) -> list[list[str]]:
    """By joint: error, and mean and deviation over logs of what is constant."""
    constant = 100 * np.stack([o.constant for o in found])
    lines = []
    for k, name in enumerate(names):
        error = 100 * np.mean([np.nanmean(np.linalg.norm(o.away[:, k], axis=-1)) for o in found])
        cells = [f"{m:+.2f} ± {s:.2f}" for m, s in zip(constant[:, k].mean(0), constant[:, k].std(0))]
        moves = 100 * np.mean([np.nanstd(o.away[:, k], 0) for o in found], 0)
        lines.append([name, f"{error:.2f}", *cells, f"{np.linalg.norm(moves):.2f}"])
    return lines


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    every: int = 1,
    frames: int = 0,
    oracles: bool = True,
    out: Path = Path(__file__).parent,
) -> None:
    """How much of the error is constant in a log.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        oracles: track with true stature and true lengths, too.
        out: folder for offsets.md.
    """
    body, settings = human(), Settings()
    found: dict[str, list[Offsets]] = {"nothing given": []}
    names: tuple[str, ...] = ()
    for path in tqdm(log_files(recordings)[::every], "recordings", leave=False, disable=None):
        log, dims = load_log(path, body, settings, frames), load_dims(path)
        given = {"nothing given": (body, 0.0)}
        if oracles:
            given["true stature"] = body, dims["stature"]
            given["true stature and lengths"] = true_lengths(body, dims), dims["stature"]
        for name, (its, scale) in given.items():
            how = replace(settings, start=replace(settings.start, scale=scale))
            tracks = log.track(its, how)
            found.setdefault(name, []).append(offsets(log, tracks, round(dims["stature"], 3)))
        names = log.names
    lines = [[name, *line] for name, some in found.items() for line in rows(some)]
    text = table(["tracked with", "", "logs", "mean joint error, cm"], lines, left=2) + "\n"
    head = ["joint", "error, cm", "forward, cm", "left, cm", "up, cm", "moves, cm"]
    write(out, "offsets", text + table(head, joint_rows(found["nothing given"], names)))


if __name__ == "__main__":
    tyro.cli(main)
