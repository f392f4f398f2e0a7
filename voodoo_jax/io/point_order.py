"""Names of key points without names: compares the orders of all known systems with that number of points, and chooses
the order in which limbs have a person's proportions. Host side."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from voodoo_jax.io.landmark_table import Gathered
from voodoo_jax.model.marker_names import JOINT, counted, orders, readings

# lengths as shares of the stature (Drillis and Contini 1966, in Winter 2009, fig. 4.1); shoulder to hip: the difference
# of their heights
BONES = {
    ("shoulder", "elbow"): 0.186, ("elbow", "wrist"): 0.146, ("hip", "knee"): 0.245, ("knee", "ankle"): 0.246,
    ("shoulder", "hip"): 0.288,
}  # fmt: skip
SOME = 60  # times at which points are looked at; by hand
# deviation from a person's limbs, see unlikeness. Measured: 0.11 to 0.23 for a Kinect's skeletons of 27 real logs, 0.09
# to 0.10 for simulated people in their order, 0.49 to 0.97 in another one
PERSONS = 0.35
UNNAMED = "limbs would not be a person's. State the point of the body of each: --features.names 'NAME=...'."
SHORTEST = 0.001  # metres: of points in one place, so that there is a logarithm; by hand


def in_known_order(topic: str, found: Gathered, notes: list[str]) -> Gathered:
    """Numbered 3D points with the names that they have in the likeliest order; others as they are."""
    number = counted({name: name for name in found.names})
    systems = orders(number[0]) if number[1] and found.values.shape[1:] == (3,) else {}
    if not systems:
        return found
    which = np.array([number[1][name] for name in found.names])
    times, row = np.unique(found.stamps, return_inverse=True)
    places = np.full((len(times), number[0], 3), np.nan)
    places[row, which] = found.values
    some = places[:: len(times) // SOME + 1]
    unlike = {system: unlikeness(some, names) for system, names in systems.items()}
    best = min(unlike, key=lambda system: unlike[system])
    ours = all(name.startswith(JOINT.format(number[0])) for name in found.names)
    if unlike[best] > PERSONS:
        notes.append(
            f"'{topic}': its {number[0]} points are in no order that is known ({', '.join(systems)}): {UNNAMED}"
        )
        return replace(found, names=tuple(f"unnamed/{k}" for k in which.tolist())) if ours else found
    if not ours and best == next(iter(systems)):  # as their numbers are read in any case
        return found
    return replace(found, names=tuple(systems[best][k] for k in which.tolist()))


def unlikeness(places: Float[np.ndarray, "time point 3"], names: Sequence[str]) -> float:
    """How unlike a person's limbs those of points with these names are: deviation (rms) of the logarithms of their
    lengths from usual ones of one stature. Limbs that change, or of which left and right differ, deviate, too."""
    at = {(side, stem): k for k, name in enumerate(names) for side, stem in readings(name) if side}
    ends = [
        (at[side, a], at[side, b], share)
        for (a, b), share in BONES.items() for side in "lr" if {(side, a), (side, b)} <= at.keys()
    ]  # fmt: skip
    one, other, share = map(np.array, zip(*ends))
    length = np.linalg.norm(places[:, one] - places[:, other], axis=-1)
    off = np.log(np.maximum(length, SHORTEST) / share)
    off = off[np.isfinite(off)]
    return float(np.sqrt(np.mean((off - np.median(off)) ** 2))) if off.size else np.inf
