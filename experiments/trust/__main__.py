"""How far tracks can be trusted: the numbers of voodoo_jax/trackers/shared/confidence.py and what they are worth.

python -m experiments.trust RECORDINGS tracks every recording as it is and made harder, fits the logistic functions on
one half of the people and compares what they say with what is right on the other half. Writes trust.md and trust.png.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.figure import Figure
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import mannwhitneyu
from tqdm import tqdm

from experiments.bench.replay_speed import machine
from experiments.common import DEMO, log_files, machine_line, table, write
from experiments.judged import trials
from experiments.trust.gather import Job, Told, work
from voodoo_jax.config.options import Settings
from voodoo_jax.trackers.shared.confidence import CLUES, ONE_PASS, THERE_AND_BACK, Trust, probability

CHANGES = (
    "as they are", "depth only", "every third frame", "every fifth frame", "three times the noise",
    "distances in a Kinect's steps", "first 40 % cut off",
)  # fmt: skip
EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0)
WEAK = 1e-3  # weight of the squared slopes: keeps them finite where everything is right


def fitted(clues: np.ndarray, close: np.ndarray, count: int, weight: np.ndarray | None = None) -> Trust:
    """The logistic function of the first `count` clues with the highest likelihood; `weight` what each joint counts."""
    x, y = clues.reshape(-1, clues.shape[-1])[:, :count], close.ravel()
    known = np.isfinite(x).all(1)
    x, y = x[known], y[known].astype(float)
    share = np.full(len(y), 1 / len(y)) if weight is None else weight[known] / weight[known].sum()
    middle, spread = x.mean(0), np.maximum(x.std(0), 1e-9)
    rows = np.c_[np.ones(len(x)), (x - middle) / spread]

    def cost(b: np.ndarray) -> tuple[float, np.ndarray]:
        z = rows @ b
        slope = rows.T @ (share * (expit(z) - y)) + 2 * WEAK * np.r_[0, b[1:]]
        return float(share @ (np.logaddexp(0, z) - y * z) + WEAK * b[1:] @ b[1:]), slope

    b = minimize(cost, np.zeros(rows.shape[1]), jac=True).x
    slopes = b[1:] / spread
    return Trust(float(b[0] - slopes @ middle), tuple(float(s) for s in slopes))


def held_out(told: list[Told], count: int) -> list[np.ndarray]:
    """[frame, joint] of each recording: what the other half of the people lets one expect; what
    trackers/shared/confidence.py says where there was one pass only."""
    people = sorted({t.stature for t in told})
    half = [people.index(t.stature) % 2 for t in told]
    if len(people) < 2:  # the demo: nobody else to learn from
        of = [(THERE_AND_BACK, ONE_PASS)[count < len(CLUES)]]
    else:
        of = [_fit([t for t, h in zip(told, half) if h != k], count) for k in (0, 1)]
    said = [probability(of[h], t.clues) for t, h in zip(told, half)]
    return [np.where(np.isfinite(p), p, probability(ONE_PASS, t.clues)) for p, t in zip(said, told)]


def _fit(told: list[Told], count: int) -> Trust:
    return fitted(np.concatenate([t.clues for t in told]), np.concatenate([t.close for t in told]), count)


def rank(said: np.ndarray, right: np.ndarray) -> float:
    """Probability that a right joint is trusted more than a wrong one (area under the ROC curve)."""
    good = int(right.sum())
    pairs = good * (len(right) - good)
    return float(mannwhitneyu(said[right], said[~right]).statistic) / pairs if pairs else float("nan")


def reliability(said: np.ndarray, right: np.ndarray) -> list[tuple[int, float, float]]:
    """Of every class of what is said: how many, mean of what is said, share that is right."""
    label = np.clip(np.digitize(said, EDGES) - 1, 0, len(EDGES) - 2)
    classes = [label == k for k in range(len(EDGES) - 1)]
    return [(int(c.sum()), float(said[c].mean()), float(right[c].mean())) for c in classes if c.any()]


def draw(found: dict[str, list[tuple[int, float, float]]]) -> Figure:
    """What is right against what is said."""
    figure, panel = plt.subplots(figsize=(5, 4.5), layout="constrained")
    panel.plot([0, 1], [0, 1], color="grey", lw=0.8)
    for name, rows in found.items():
        panel.plot([r[1] for r in rows], [r[2] for r in rows], "o-", ms=4, label=name)
    panel.set(xlabel="said: probability to be within 10 cm", ylabel="joints of other people within 10 cm, share")
    panel.legend()
    return figure


def section(jobs: list[Job], told: list[Told], count: int) -> tuple[str, list[tuple[int, float, float]]]:
    """Tables of what is said with the first `count` clues; and what is right by classes of that."""
    said = held_out(told, count)
    shares, right = [s.mean(1) for s in said], [t.root for t in told]
    parts = {job.change: [k for k, other in enumerate(jobs) if other.change == job.change] for job in jobs}
    parts["all"] = list(range(len(jobs)))

    def joints_of(part: str) -> tuple[np.ndarray, np.ndarray]:
        p, y = (np.concatenate([a[k].ravel() for k in parts[part]]) for a in (said, [t.close for t in told]))
        return p, y

    rows = []
    for change, mine in parts.items():
        p, y = joints_of(change)
        share, root = (np.concatenate([a[k] for k in mine]) for a in (shares, right))
        sure = share >= Settings().track.lost_confidence
        honest = [f"{100 * root.mean():.1f}", f"{100 * root[sure].mean():.1f}", f"{100 * sure.mean():.1f}"]
        rank_of = f"{rank(p, y):.3f}" if y.any() and not y.all() else "-"
        rows.append([change, f"{100 * p.mean():.1f}", f"{100 * y.mean():.1f}", rank_of, *honest])
    head = ["recordings", "said, %", "right, %", "right above wrong", "pelvis within 20 cm, %"]
    head += ["of frames not doubted, %", "frames not doubted, %"]
    curve = reliability(*joints_of("all"))
    classes = [[f"{n}", f"{100 * a:.1f}", f"{100 * b:.1f}"] for n, a, b in curve]
    trust = _fit(told, count)
    numbers = [[c, f"{s:.3f}"] for c, s in zip(("constant", *CLUES), (trust.constant, *trust.slopes))]
    of_classes, of_all = table(["joints", "said, %", "right, %"], classes), table(["clue", "slope"], numbers)
    return f"{table(head, rows)}\n{of_classes}\nWith all people:\n\n{of_all}", curve


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    every: int = 1,
    frames: int = 0,
    changes: tuple[str, ...] = CHANGES,
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """How far tracks can be trusted.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        every: take every N-th recording.
        frames: cut recordings after so many frames; 0: whole.
        changes: what is done to the recordings: see experiments/stress/changes.py.
        processes: how many work at once.
        out: folder for trust.md and trust.png.
    """
    files, before = log_files(recordings)[::every], machine()
    sections, curves = [], {}
    for name, both_ways, count in (("there and back", True, len(CLUES)), ("one pass", False, len(CLUES) - 1)):
        jobs = [Job(change, both_ways, file, frames) for change in changes for file in files]
        told = list(tqdm(trials(work, jobs, processes), total=len(jobs), leave=False, disable=None, desc=name))
        text, curves[name] = section(jobs, told, count)
        sections.append(f"## {name[0].upper()}{name[1:]}\n\n{text}")
    write(out, "trust", f"{len(files)} recordings. {machine_line(before)}\n" + "\n".join(sections), draw(curves))


if __name__ == "__main__":
    tyro.cli(main)
