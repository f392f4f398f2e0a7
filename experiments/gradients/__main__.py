"""Are derivatives those of the solution? python -m experiments.gradients [RECORDINGS]

Random pairs of a frame and a parameter: the derivative of all joint centres by the parameter, forward mode, beside the
central difference of two solutions that choose anew, in float64. Writes gradients.md.
"""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Array, Float
from tqdm import tqdm

from experiments.common import DEMO, human, log_files, table, write
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.objective import FitFrames, changed_features
from voodoo_jax.fitting.parameters import Parameters, changed, changed_options, changed_points, middles, parameters
from voodoo_jax.fitting.problem import Problem, problem
from voodoo_jax.model.body import joint_centres
from voodoo_jax.solve import frame as one_frame
from voodoo_jax.solve.implicit import solution
from voodoo_jax.solve.pulls import Chosen

# all that a frame's poses depend on but what tells of the frame before
FREE = (
    "scale", "lengths.*", "radii.*", "anchors.*", "bands.*", "solve.ratio", "solve.floor", "solve.prior",
    "solve.prior_radius", "solve.robust_scale", "solve.limits", "sensors.*",
)  # fmt: skip
STEPS = (1e-3, 1e-4, 1e-5)  # in logarithms, metres, radians
NEAR = 0.03  # of the difference
NOTHING = 2e-3  # metres per unit: a joint that 1 % of a length moves by less than 0.02 mm is not moved
AT_REST = 1e-9  # metres: far below what a step moves


class There(NamedTuple):
    """A frame solved with one value of a parameter."""

    joints: Float[Array, "centre 3"]  # metres
    slope: Float[Array, "centre 3"]  # by the parameter
    chosen: Chosen
    changing: Array
    converged: Array


def solver(known: Parameters, one: Problem):
    """Solves a frame at a value of one parameter, all others 0; compiled once for all."""
    options = one.options.icp
    # a frame alone: nothing stands still beside it, and all steps are taken
    options = eqx.tree_at(lambda o: (o.steady, o.epsilon), options, (jnp.zeros(()), jnp.zeros(())))
    body, options = in_float64((one.body, options))

    def joints(value, which, frame: FitFrames):
        by = known.changes(jnp.zeros(len(known.names)).at[which].set(value))
        new = changed(body, by)
        points, features = changed_points(frame.points, by, middles(frame.points)), changed_features(frame, by)
        asked = one_frame.Problem.build(new, points, frame.poses, changed_options(options, by), features)
        found = solution(frame.poses, asked, tolerance=AT_REST)
        return joint_centres(new, found.poses), (found.chosen, found.changing, found.converged)

    @jax.jit
    def at(value, which, frame) -> There:
        there, slope, said = jax.jvp(lambda v: joints(v, which, frame), (value,), (jnp.ones(()),), has_aux=True)
        return There(there, slope, *said)

    return at


def in_float64(tree):
    """All numbers of float32 in float64."""
    wide = lambda x: x.astype(jnp.float64) if eqx.is_inexact_array(x) else x  # noqa: E731
    return jax.tree.map(wide, tree)


class Pair(NamedTuple):
    """A frame and a parameter, by step of the differences."""

    log: str
    frame: int
    name: str
    off: dict[float, float]  # share of the difference
    other: dict[float, int]  # how many choices differ between the two sides
    changing: int
    converged: bool


def compared(log: str, known: Parameters, at, frames: FitFrames, picked: list[tuple[int, int]]) -> list[Pair]:
    """The pairs of (frame, parameter) of one recording."""
    found = []
    for number, which in tqdm(picked, log, leave=False, disable=None):
        frame = in_float64(jax.tree.map(lambda x, n=number: x[n], frames))
        here = at(0.0, which, frame)
        off, other = {}, {}
        for step in STEPS:
            ahead, behind = at(step, which, frame), at(-step, which, frame)
            difference = (ahead.joints - behind.joints) / (2 * step)
            size = jnp.maximum(jnp.linalg.norm(difference), NOTHING)
            off[step] = float(jnp.linalg.norm(here.slope - difference) / size)
            other[step] = int(ahead.chosen.points.differs(behind.chosen.points).sum())
            other[step] = max(
                other[step], int(ahead.chosen.differs(behind.chosen)), int(here.chosen.differs(ahead.chosen))
            )
        found.append(Pair(log, number, known.names[which], off, other, int(here.changing), bool(here.converged)))
    return found


def report(pairs: list[Pair]) -> str:
    """By step, and the pairs that nothing explains."""
    head = ["step", "within 3 %", "off, a choice changes", "off, none does", "median off", "choices differ at all"]
    rows = []
    for step in STEPS:
        off = np.array([p.off[step] for p in pairs])
        other = np.array([p.other[step] > 0 for p in pairs])
        far = off > NEAR
        cells = [(~far).sum(), (far & other).sum(), (far & ~other).sum()]
        rows.append(
            [f"{step:.0e}", *(f"{n} of {len(pairs)}" for n in cells), f"{100 * np.median(off):.1e} %", f"{other.sum()}"]
        )
    least = STEPS[-1]
    lines = [
        f"{p.log}, frame {p.frame}, {p.name}: {100 * p.off[least]:.0f} % off, {p.other[least]} choices differ"
        for p in pairs
        if p.off[least] > NEAR
    ]
    rest = sum(not p.converged for p in pairs)
    said = (
        f"\n{len(pairs) - rest} of {len(pairs)} pairs' frames are at rest. With the smallest step more than 3 % off:\n"
    )
    return table(head, rows) + said + "".join(f"\n* {line}" for line in lines) + "\n"


def main(
    recordings: tyro.conf.Positional[Path] = DEMO,
    pairs: int = 200,
    logs: int = 4,
    points: int = 256,
    frames: int = 0,
    seed: int = 0,
    out: Path = Path(__file__).parent,
) -> None:
    """Derivatives beside differences.

    Args:
        recordings: folder with *.mcap and *.truth.npz; none: the demo recording.
        pairs: of a frame and a parameter, drawn at random.
        logs: recordings they are drawn from, at most, evenly among those of the folder.
        points: of a frame, at most.
        frames: of each recording (0: all).
        seed: of the draw.
        out: folder for gradients.md.
    """
    files, rng = log_files(recordings), np.random.default_rng(seed)
    chosen = [files[i] for i in sorted(set(np.linspace(0, len(files) - 1, logs).round().astype(int).tolist()))]
    some = [(file, problem(human(), file, Settings(), points=points, frames=frames)) for file in chosen]
    found: list[Pair] = []
    with jax.enable_x64(True):
        for k, (file, one) in enumerate(some):
            free = (*FREE, "features.*") if one.features else FREE
            known = parameters(one.body, free, one.features, sensors=one.frames.points.origins.shape[-2])
            here = np.flatnonzero(np.asarray(one.frames.weight) > 0)
            count = pairs // len(some) + (k < pairs % len(some))
            picked = [(int(rng.choice(here)), int(rng.integers(len(known.names)))) for _ in range(count)]
            found += compared(file.stem, known, solver(known, one), one.frames, picked)
    write(out, "gradients", report(found))


if __name__ == "__main__":
    tyro.cli(main)
