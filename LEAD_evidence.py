"""What is known of arms, legs and heads by points that no other limb explains. Host side, NumPy.

Points pull a limb that nobody sees onto a neighbour that is seen, and it lies on them as well as that. It is not known
by them: without it they would be explained as well as they are.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float32

from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.body import Topology
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.trackers.icp.limb_distance import signed_distance

POINTS = 250  # of a frame, evenly taken; by hand
FEWEST = 3  # of them near a limb: fewer do not tell on what it lies; by hand
REACH = 0.1  # metres: a point that is so far from all other limbs needs this one, farther ones do not need it more
BATCH = 100  # frames that are looked at at once; by hand


def extremities(topology: Topology) -> tuple[tuple[int, ...], ...]:
    """Limbs that hang in one row on a limb that more than one hangs on: head, arms and legs of a person."""
    under: dict[int, list[int]] = {k: [] for k in range(len(topology.limbs))}
    for parent, child in zip(topology.parents, topology.children):
        under[parent].append(child)

    def row(limb: int) -> tuple[int, ...]:
        """The limb and all beyond it; nothing where these branch."""
        if len(under[limb]) > 1:
            return ()
        beyond = row(under[limb][0]) if under[limb] else ()
        return (limb, *beyond) if beyond or not under[limb] else ()

    return tuple(found for some in under.values() if len(some) > 1 for child in some if (found := row(child)))


def needed(
    sizes: Float[np.ndarray, "limb 5"],
    topology: Topology,
    rotation: Float32[np.ndarray, "frame limb 4"],
    translation: Float32[np.ndarray, "frame limb 3"],
    people: Sequence[BodyObservation],
) -> Float[np.ndarray, "frame extremity"]:
    """How much worse the points that are nearest to an extremity would be explained without it, root mean square of the
    distance to the next limb beyond the distance to it, metres, at most REACH; NaN where no points are near it.

    **Arguments:** `sizes` of the limbs as in Body; poses T_fixed_limb in the frame of the points, unit quaternions
    wxyz and metres.
    """
    rows = extremities(topology)
    out = np.full((len(translation), len(rows)), np.nan)
    there = np.all(np.isfinite(translation), axis=(1, 2))
    use = np.flatnonzero(there) if rows else np.zeros(0, int)
    for at in range(0, len(use), BATCH):
        some = use[at : at + BATCH]
        out[some] = _needed(sizes, rows, rotation[some], translation[some], [people[k] for k in some])
    return out


def _needed(
    sizes: np.ndarray, rows: tuple[tuple[int, ...], ...], rotation: np.ndarray, translation: np.ndarray,
    clouds: list[BodyObservation],
) -> Float[np.ndarray, "frame extremity"]:  # fmt: skip
    """See needed; of frames whose poses are known."""
    taken = [f.points[:: len(f.points) // POINTS + 1] for f in clouds]
    points = np.concatenate(taken).astype(float)
    frame = np.repeat(np.arange(len(clouds)), [len(some) for some in taken])
    off = np.empty((len(sizes), len(points)))
    for k, size in enumerate(np.asarray(sizes, float)):
        turn = rotations(rotation[:, k]).inv().as_matrix()[frame]  # made frame by frame: points are many more
        local = np.einsum("nij,nj->ni", turn, points - translation[frame, k])
        off[k] = np.abs(signed_distance(size, local))
    off, nearest = np.minimum(off, REACH), np.argmin(off, 0)
    out = np.full((len(clouds), len(rows)), np.nan)
    for j, row in enumerate(rows):
        mine = np.isin(nearest, row)
        own, other = off[:, mine].min(0), np.delete(off[:, mine], row, 0).min(0)
        count = np.bincount(frame[mine], minlength=len(clouds))
        total = np.bincount(frame[mine], other**2 - own**2, len(clouds))
        known = count >= FEWEST
        out[known, j] = np.sqrt(np.maximum(total[known] / count[known], 0.0))
    return out
