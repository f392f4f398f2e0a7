"""Detects and corrects exchanged marker names, for a time or for the whole recording. Host side.

Within a recording, an exchange is two markers that each jump to the place of the other; the names held for longer count
as right. An exchange of left and right for the whole recording shows in body sizes that are impossible.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from voodoo_jax.markers.size_fit import Fit, Markers, fit_markers
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation

JUMP = 0.03  # metres: shorter jumps are motion
NEAR = 0.3  # of the jump: how near to the other one's place a marker lands
ODD = 3.0  # times its usual deviation: so far off its site a marker is suspected
BETTER = 0.8  # of the cost of a fit: what an exchange must come down to
MIRRORED = 0.5  # the same where all of left and right are exchanged; by hand: 0.05 where the data is mirrored
PAIRS = 3  # of left and right, at least, to tell that; by hand


class Exchange(NamedTuple):
    """Two names that were exchanged."""

    first: str
    second: str
    frames: Bool[np.ndarray, " frame"]


def jumps(markers: Markers) -> list[Exchange]:
    """Exchanges within a recording."""
    found = []
    count = markers.points.shape[1]
    # of those that are seen throughout two that never jump need not be compared
    steps = np.linalg.norm(np.diff(markers.points, axis=0), axis=2).max(0, initial=0)
    calm = markers.seen.all(0) & (steps < JUMP / 2)
    for a in range(count):
        for b in range(a + 1, count):
            if calm[a] and calm[b]:
                continue
            both = np.flatnonzero(markers.seen[:, a] & markers.seen[:, b])
            if len(both) < 2:
                continue
            p, q = markers.points[both, a], markers.points[both, b]
            far = lambda u, v: np.linalg.norm(u[1:] - v[:-1], axis=1)  # noqa: E731
            stay, cross = np.maximum(far(p, p), far(q, q)), np.maximum(far(p, q), far(q, p))
            event = (stay > JUMP) & (cross < NEAR * stay)
            if not event.any():
                continue
            odd = np.concatenate([[0], np.cumsum(event)]) % 2
            odd = odd if odd.mean() <= 0.5 else 1 - odd
            # in frames with one of them only: as in the last frame with both
            last = np.searchsorted(both, np.arange(len(markers.seen)), "right") - 1
            frames = odd[np.maximum(last, 0)].astype(bool)
            found.append(Exchange(markers.names[a], markers.names[b], frames))
    return found


def sides(
    body: Body, markers: Markers, sites: list[str], scale_known: bool = False
) -> tuple[Markers, Fit, list[Exchange], bool]:
    """Left and right markers that are exchanged in all of some frames: the corrected markers, and their fit; and
    whether all are exchanged, as with left-handed coordinates.

    **Arguments:** `sites` the body's name of each marker's place.
    """
    fit, found = fit_markers(body, markers, scale_known=scale_known), []
    once = {s for s in sites if sites.count(s) == 1}
    other = {k: sites.index("r_" + s[2:]) for k, s in enumerate(sites) if s[:2] == "l_" and {s, "r_" + s[2:]} <= once}
    wrong = bool(other) and max(fit.shifts[k] for k in (*other, *other.values())) > ODD
    mirrored, every = False, np.ones(len(markers.seen), bool)
    if wrong and len(other) >= PAIRS:
        swapped, again = _exchanged(body, markers, other, scale_known)
        if mirrored := again.cost < MIRRORED * fit.cost:
            markers, fit = swapped, again
            found = [Exchange(markers.names[a], markers.names[b], every) for a, b in other.items()]
    odd = sorted(other, key=lambda k: -max(fit.shifts[k], fit.shifts[other[k]]))
    for a in [k for k in odd if max(fit.shifts[k], fit.shifts[other[k]]) > ODD][:4]:
        b = other[a]
        swapped, again = _exchanged(body, markers, {a: b}, scale_known)
        if again.cost < BETTER * fit.cost:
            markers, fit = swapped, again
            found.append(Exchange(markers.names[a], markers.names[b], every))
    return markers, fit, found, mirrored


def _exchanged(body: Body, markers: Markers, pairs: dict[int, int], scale_known: bool) -> tuple[Markers, Fit]:
    """The markers with some pairs of names exchanged, and their fit."""
    order = np.arange(len(markers.names))
    for a, b in pairs.items():
        order[[a, b]] = b, a
    swapped = markers._replace(points=markers.points[:, order], seen=markers.seen[:, order])
    return swapped, fit_markers(body, swapped, scale_known=scale_known)


def put_right(frames: list[BodyObservation], exchanges: list[Exchange]) -> list[BodyObservation]:
    """The frames with corrected names."""
    out = list(frames)
    for first, second, when in exchanges:
        other = {first: second, second: first}
        for i in np.flatnonzero(when):
            pairs = out[i].pairs
            out[i] = replace(out[i], pairs=replace(pairs, names=tuple(other.get(n, n) for n in pairs.names)))
    return out
