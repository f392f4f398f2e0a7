"""What wrists tell of the forearms' lengths: python -m experiments.forearms RECORDINGS

Every recording is tracked with the usual forearms, with the 2D features and without. The constants of
voodoo_jax/trackers/icp/refine/fit_forearms.py are fitted to what the truth says (people count alike, however many
recordings there are of them), and for every person to the others alone: that column is what a stranger can expect.
Writes forearms.md and forearms.png.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from scipy.optimize import least_squares
from tqdm import tqdm

from experiments.common import DEMO, human, load_dims, load_log, log_files, table, without_features, write
from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import segment_lengths
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.trackers.icp.refine.fit_forearms import FitForearms, Stretch, stretch

NOW = (FitForearms.by_points, FitForearms.by_names, FitForearms.hand)


def fitted(gap: np.ndarray, named: np.ndarray, true: np.ndarray, person: np.ndarray) -> np.ndarray:
    """The constants that fit best, each person counting the same."""
    share = np.sqrt(1 / np.bincount(person)[person])
    start, scale = np.array(NOW), 100.0
    # by logarithms: a share that is stretched is never negative
    found = least_squares(
        lambda x: scale * share * (FitForearms(*start * np.exp(x)).asked(gap, named) - true), np.zeros(3)
    )
    return start * np.exp(found.x)


def main(
    recordings: tyro.conf.Positional[Path] = DEMO, every: int = 1, frames: int = 0, out: Path = Path(__file__).parent
) -> None:
    """What wrists tell of the forearms' lengths.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        out: folder for forearms.md and forearms.png.
    """
    body, settings = human(), Settings()
    usual = replace(settings, track=replace(settings.track, skip=("fit_forearms",)))
    names = FeatureNames(body.topology, settings.features)
    found: list[Stretch] = []
    labels, scale, true, stature = [], [], [], []
    for path in tqdm(log_files(recordings)[::every], "recordings", leave=False, disable=None):
        log = load_log(path, body, settings, frames)
        dims = load_dims(path)
        for kind, people in (("features", log.people), ("depth alone", without_features(log.people))):
            tracks = log.track(body, usual, people)
            seen = stretch(tracks.body, people, names, tracks)
            if seen is None:
                raise SystemExit(f"{path}: no hand was seen in it, there is nothing to measure")
            found.append(seen)
            labels.append((log.name, kind))
            scale.append(float(tracks.body.scale))
            true.append(dims["forearm"] / scale[-1] - segment_lengths(tracks.body)["forearm"] / scale[-1])
            stature.append(round(dims["stature"], 3))
    gap, named = (np.array([getattr(s, name) for s in found]) for name in ("gap", "named"))
    scale, true = np.array(scale), np.array(true)
    persons = sorted(set(stature))
    person = np.array([persons.index(s) for s in stature])
    # of every recording: error with the usual forearm, with the constants of now, with those of the other people
    now = np.array([FitForearms().lengthened(s) for s in found])
    others = np.full(len(found), np.nan)
    for one in range(len(persons) if len(persons) > 2 else 0):
        rest = person != one
        constants = fitted(gap[rest], named[rest], true[rest], np.unique(person[rest], return_inverse=True)[1])
        others[~rest] = FitForearms(*constants).asked(gap, named)[~rest]
    off = 100 * scale[:, None] * (np.stack([0 * now, now, others], 1) - true[:, None])
    cell = lambda x: f"{x:+.2f}" if np.isfinite(x) else "-"  # noqa: E731
    lines = [[*label, f"{1000 * s.gap:.2f}", f"{s.named:.2f}", *map(cell, row)]
            for label, s, row in zip(labels, found, off)]  # fmt: skip
    for kind in ("features", "depth alone"):
        mean = np.abs(off[[k == kind for _, k in labels]]).mean(0)
        lines.append([f"**mean size, {kind}**", "", "", "", *(f"{x:.2f}" if np.isfinite(x) else "-" for x in mean)])
    head = ["recording", "measured by", "gap, ‰ of the stature", "hand named in",
            "usual forearm, cm off", "as tracked now, cm off", "constants of the other people, cm off"]  # fmt: skip
    text = table(head, lines, left=2)
    if len(persons) > 2:
        best = " / ".join(f"{x:.4f}" for x in fitted(gap, named, true, person))
        text += f"\nConstants that fit all best (by_points / by_names / hand): {best}; used: {NOW}.\n"
    figure, axes = plt.subplots(figsize=(6, 4.5), layout="constrained")
    for kind, marker in (("features", "o"), ("depth alone", "x")):
        chosen = np.array([k == kind for _, k in labels])
        axes.plot(100 * (scale * true)[chosen], 100 * (scale * now)[chosen], marker, label=kind)
    reach = 100 * float(np.max(np.abs(scale * true))) + 0.5
    axes.plot([-reach, reach], [-reach, reach], color="gray", linewidth=0.8)
    axes.set(xlabel="true forearm less the body's usual one, cm", ylabel="found, cm", title="Forearms by the wrists")
    axes.legend()
    write(out, "forearms", text, figure)


if __name__ == "__main__":
    tyro.cli(main)
