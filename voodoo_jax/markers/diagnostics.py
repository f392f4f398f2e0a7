"""What is odd about the markers of a recording, in sentences: missing, exchanged, misplaced, with unknown names."""

from difflib import get_close_matches

import numpy as np
from jaxtyping import Bool, Int64

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.markers.label_swaps import Exchange
from voodoo_jax.markers.table import CLOSE, MarkerTable, places
from voodoo_jax.model.body import Body
from voodoo_jax.model.marker_sets import PLUG_IN_GAIT

GAP = 0.2  # seconds: a marker that is away for longer is named
SHOWN = 3  # gaps of one marker that are named one by one


def runs(mask: Bool[np.ndarray, " frame"]) -> list[tuple[int, int]]:
    """First and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2])]


def marker_notes(
    body: Body,
    table: MarkerTable,
    poses: Poses,
    stamps: Int64[np.ndarray, " frame"],
    tracked: Bool[np.ndarray, " frame"],
    exchanges: list[Exchange],
) -> tuple[str, ...]:
    """Notes on the markers of tracked frames. `poses` of every frame, NaN where there are none;
    `exchanges` were put right before."""
    seconds = (stamps - stamps[0]) / 1e9
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0

    def long(mask: np.ndarray) -> list[tuple[int, int]]:
        return [(a, b) for a, b in runs(mask) if seconds[b] - seconds[a] + step > GAP]

    def told(some: list[tuple[int, int]]) -> str:
        text = ", ".join(f"{a} to {b}" for a, b in some[:SHOWN])
        return text + (f" and {len(some) - SHOWN} more times" if len(some) > SHOWN else "")

    known = table.markers
    some = np.asarray(known.seen.any(1))
    at = places(body, known.rows, poses)
    notes = []
    if empty := long(~some):
        notes.append(f"There are no markers in frames {told(empty)}.")
    for e in exchanges:
        where = "all frames" if e.frames.all() else f"frames {told(runs(e.frames))}"
        notes.append(f"Markers {e.first} and {e.second} were exchanged in {where}: put right.")
    for k, name in enumerate(known.names):
        gaps = long(~known.seen[:, k] & some)
        if gaps:
            length = sum(seconds[b] - seconds[a] + step for a, b in gaps)
            notes.append(f"Marker '{name}' is missing for {length:.1f} s (frames {told(gaps)}).")
    off = np.linalg.norm(at - known.points, axis=-1)
    far = known.seen & (off > CLOSE) & tracked[:, None]
    exchanged = np.zeros_like(far)
    often = np.flatnonzero(far.sum(0) * step > GAP)
    for i, a in enumerate(often):
        for b in often[i + 1 :]:
            across = np.linalg.norm(at[:, a] - known.points[:, b], axis=-1)
            across = np.maximum(across, np.linalg.norm(at[:, b] - known.points[:, a], axis=-1))
            both = known.seen[:, a] & known.seen[:, b] & (far[:, a] | far[:, b])
            swapped = both & (across < 0.5 * np.maximum(off[:, a], off[:, b])) & tracked
            if found := long(swapped):
                exchanged[:, [a, b]] |= swapped[:, None]
                names = f"{known.names[a]} and {known.names[b]}"
                notes.append(f"Markers {names} seem exchanged (frames {told(found)}).")
    for k in often:
        if found := long(far[:, k] & ~exchanged[:, k]):
            away = 100 * np.median(off[far[:, k], k])
            notes.append(
                f"Marker '{known.names[k]}' is {away:.0f} cm from its place (frames {told(found)}); not used there."
            )
    return (*notes, *_unknown(body, table, poses, tracked))


def _unknown(body: Body, table: MarkerTable, poses: Poses, tracked) -> list[str]:
    """Notes on names that the body does not know: where they sit and what they may be."""
    t, other = body.topology, table.unknown
    names = (*t.sites, *t.centres)
    sets = {site: marker for marker, site in PLUG_IN_GAIT.items()}
    rows = np.array([i for i, n in enumerate(names) if n in sets], np.int64)
    at = places(body, rows, poses)
    mine = dict(zip(table.markers.rows.tolist(), table.markers.seen.T))
    notes = []
    for k, name in enumerate(other.names):
        use = other.seen[:, k] & tracked
        text = f"Marker '{name}' was not used ({int(other.seen[:, k].sum())} times): no point of this body has the name"
        hint = ""
        if use.any() and len(rows):
            off = np.median(np.linalg.norm(at[use] - other.points[use, k][:, None], axis=-1), 0)
            # a place whose own marker is there at the same time is taken
            free = np.array([not (mine[r][use].mean() > 0.5) if r in mine else True for r in rows.tolist()])
            best = int(np.argmin(np.where(free, off, np.inf)))
            if free[best] and off[best] < CLOSE:
                site = names[rows[best]]
                hint = f"; it sits where {sets[site]} ({site}) belongs: features.names '{name}={site}'"
        near = get_close_matches(name.upper(), PLUG_IN_GAIT, 1)
        if not hint and near:
            hint = f"; did you mean {near[0]}?"
        notes.append(text + hint + ".")
    return notes
