"""The papers' Table I (Knoop 2006, sec. V) on recordings with truth: python -m experiments.table1 [RECORDINGS]

Grades 0 lost, 1 acceptable, 2 good by the rule in experiments/common.py, beside the papers' by hand. Chains: the
default settings, and the preset "knoop2007" with the ten-limb body. Writes table1.md and table1.png.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from tqdm import tqdm

import voodoo_jax.config.presets
from experiments.common import DEMO, Score, human, load_logs, score, table, without_features, write
from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.model.body_file import load_body

PAPER = (5, 32, 63)  # of 100 sequences of ten movements, graded by hand


def chains() -> dict[str, tuple[Body, Settings]]:
    """What to compare: body and settings."""
    found = {"default settings": (human(), Settings())}
    preset = getattr(voodoo_jax.config.presets, "preset", None)
    if preset is not None:
        found["the papers' chain (knoop2007)"] = (load_body("human10"), preset("knoop2007"))
    return found


def interval(hits: int, count: int) -> str:
    """95 % interval of a share in percent (Wilson)."""
    z, p = 1.96, hits / count
    middle, half = p + z**2 / (2 * count), z * np.sqrt(p * (1 - p) / count + z**2 / (4 * count**2))
    low, high = ((middle + sign * half) / (1 + z**2 / count) for sign in (-1, 1))
    return f"{100 * max(low, 0):.0f} to {100 * min(high, 1):.0f}"


def counts(scores: list[Score]) -> tuple[int, ...]:
    """Recordings of grade 0, 1 and 2."""
    return tuple(sum(s.grade == g for s in scores) for g in (0, 1, 2))


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    every: int = 1,
    frames: int = 0,
    out: Path = Path(__file__).parent,
) -> None:
    """Lost, acceptable, good.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        out: folder for table1.md and table1.png.
    """
    results: dict[str, list[Score]] = {}
    for chain, (body, settings) in chains().items():
        logs = load_logs(recordings, body, settings, every, frames)
        for inputs in ("fusion", "depth only"):
            bar = tqdm(logs, f"{chain}, {inputs}", unit="log", leave=False, disable=None)
            people = {log.name: log.people if inputs == "fusion" else without_features(log.people) for log in logs}
            results[f"{chain}, {inputs}"] = [score(log, log.track(body, settings, people[log.name])) for log in bar]
    rows = [["the papers, 2006 (by hand)", "100", *map(str, PAPER), "1.58", interval(PAPER[0], 100), "-", "-"]]
    shares: dict[str, tuple[float, ...]] = {"the papers, 2006": PAPER}
    for name, scores in results.items():
        grades, n = counts(scores), len(scores)
        shares[name] = tuple(100 * g / n for g in grades)
        error, within = (float(np.mean([getattr(s, k) for s in scores])) for k in ("error_cm", "within"))
        cells = [f"{share:.0f}" for share in shares[name]]
        mean = f"{np.mean([s.grade for s in scores]):.2f}"
        rows.append([name, str(n), *cells, mean, interval(grades[0], n), f"{error:.2f}", f"{within:.1f}"])
    head = ["chain", "recordings", "0 lost, %", "1 acceptable, %", "2 good, %", "mean grade"]
    head += ["95 % interval of lost, %", "mean joint error, cm", "within 10 cm, %"]

    figure, panel = plt.subplots(figsize=(8, 0.55 * len(shares) + 1.3), layout="constrained")
    left = np.zeros(len(shares))
    for grade, (label, colour) in enumerate(
        (("0 lost", "tab:red"), ("1 acceptable", "tab:orange"), ("2 good", "tab:green"))
    ):
        width = np.array([s[grade] for s in shares.values()])
        panel.barh(list(shares), width, left=left, color=colour, label=label)
        left += width
    panel.invert_yaxis()
    panel.set(xlabel="share of recordings, %", xlim=(0, 100))
    figure.legend(loc="outside upper center", ncols=3, fontsize=8)
    write(out, "table1", table(head, rows), figure)


if __name__ == "__main__":
    tyro.cli(main)
