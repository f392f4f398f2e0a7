"""Notes on a recording's markers: missing, exchanged, misplaced, or with unknown names."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int64

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.markers.label_swaps import Exchange
from voodoo_jax.markers.own_sites import OWN, Named
from voodoo_jax.markers.size_fit import Markers
from voodoo_jax.markers.table import CLOSE, TO_START, MarkerTable, places
from voodoo_jax.model.body import Body
from voodoo_jax.model.marker_names import nobodys
from voodoo_jax.records.notes import remark
from voodoo_jax.records.stretches import stretches

GAP = 0.2  # seconds: a marker that is away for longer is named
SHOWN = 3  # notes of one kind that are listed one by one, gaps of one marker, and names in a note on many; by hand
HINT = 0.06  # set by hand, metres: so near to a point of the body a marker may be the one that belongs there
HINTED = 0.3  # set by hand: share of the frames in which a marker must be seen to say where it sits
USUAL = "Plug-in Gait"  # the set that needs no note
FAR = 0.025  # set by hand: metres: a marker that is on average farther from its fitted place is named
FEW = f"No frame has {TO_START} markers with a known point on this body (features.names)."
MIRRORED = (
    "The positions of the named points exchange left and right: either all names are exchanged, as assumed here, or "
    "coordinates are left-handed (as Unity's are). read.mirror TOPIC=y (or x, z) inverts that axis; TOPIC=none "
    "means that the names are wrong."
)


class Spans(NamedTuple):
    """Intervals of frames."""

    seconds: np.ndarray  # of each frame
    step: float  # seconds between frames

    def long(self, mask: np.ndarray) -> list[tuple[int, int]]:
        """First and last frame of each interval that is long enough for a note."""
        return [(a, b - 1) for a, b in stretches(mask) if self.seconds[b - 1] - self.seconds[a] + self.step > GAP]

    def words(self, some: list[tuple[int, int]]) -> str:
        """Some intervals as text."""
        text = ", ".join(f"{a} to {b}" for a, b in some[:SHOWN])
        return text + (f" and {len(some) - SHOWN} more times" if len(some) > SHOWN else "")


def marker_notes(
    body: Body,
    table: MarkerTable,
    poses: Poses,
    stamps: Int64[np.ndarray, " frame"],
    tracked: Bool[np.ndarray, " frame"],
    exchanges: list[Exchange],
) -> tuple[str, ...]:
    """Notes on the markers of tracked frames. `poses` of every frame, NaN where there are none; `exchanges` were
    corrected before."""
    seconds = (stamps - stamps[0]) / 1e9
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0

    spans = Spans(seconds, step)
    known = table.markers
    some = np.asarray(known.seen.any(1))
    at = places(body, known.rows, poses)
    notes = []
    if empty := spans.long(~some):
        notes.append(f"No markers in frames {spans.words(empty)}.")
    put_right = []
    for e in exchanges:
        where = (
            "all frames" if e.frames.all() else f"frames {spans.words([(a, b - 1) for a, b in stretches(e.frames)])}"
        )
        put_right.append((f"{e.first} and {e.second}", f"were exchanged in {where}: corrected"))
    notes += in_few_lines(put_right, "pairs of markers were exchanged for a time, and corrected", "Markers ")
    missing = []
    for k, name in enumerate(known.names):
        gaps = spans.long(~known.seen[:, k] & some)
        if gaps:
            length = sum(seconds[b] - seconds[a] + step for a, b in gaps)
            missing.append((length, f"'{name}'", f"is missing for {length:.1f} s (frames {spans.words(gaps)})"))
    missing.sort(key=lambda m: -m[0])
    notes += in_few_lines([m[1:] for m in missing], "markers are missing for a time, the longest", "Marker ")
    notes += _misplaced(known, at, tracked, spans)
    return (*notes, *_residuals(residuals(body, known, poses, tracked)), *_unknown(body, table, poses, tracked))


def _misplaced(known: Markers, at: np.ndarray, tracked: np.ndarray, spans: Spans) -> list[str]:
    """Notes on markers that are for a time in another one's place, or far from their own places `at`."""
    off = np.linalg.norm(at - known.points, axis=-1)
    far = known.seen & (off > CLOSE) & tracked[:, None]
    exchanged = np.zeros_like(far)
    often = np.flatnonzero(far.sum(0) * spans.step > GAP)
    seem = []
    for i, a in enumerate(often):
        for b in often[i + 1 :]:
            across = np.linalg.norm(at[:, a] - known.points[:, b], axis=-1)
            across = np.maximum(across, np.linalg.norm(at[:, b] - known.points[:, a], axis=-1))
            both = known.seen[:, a] & known.seen[:, b] & (far[:, a] | far[:, b])
            swapped = both & (across < 0.5 * np.maximum(off[:, a], off[:, b])) & tracked
            if found := spans.long(swapped):
                exchanged[:, [a, b]] |= swapped[:, None]
                seem.append((f"{known.names[a]} and {known.names[b]}", f"seem exchanged (frames {spans.words(found)})"))
    notes = in_few_lines(seem, "pairs of markers seem exchanged", "Markers ")
    away = []
    for k in often:
        if found := spans.long(far[:, k] & ~exchanged[:, k]):
            metres = np.median(off[far[:, k], k])
            text = f"is {100 * metres:.0f} cm from its fitted position (frames {spans.words(found)}); not used there"
            away.append((metres, f"'{known.names[k]}'", text))
    away.sort(key=lambda a: -a[0])
    notes += in_few_lines([a[1:] for a in away], "markers are far from their positions for a time, farthest", "Marker ")
    return notes


def in_few_lines(found: list[tuple[str, str]], many: str, one: str) -> list[str]:
    """A note for each (name, text), or one note for many."""
    if len(found) <= SHOWN:
        return [f"{one}{name} {text}." for name, text in found]
    listed = "; ".join(f"{name} {text}" for name, text in found[:SHOWN])
    names = ", ".join(name for name, _ in found[SHOWN : 2 * SHOWN])
    more = f"; then {names}" + (f" and {len(found) - 2 * SHOWN} more" if len(found) > 2 * SHOWN else "")
    return [f"{len(found)} {many}: {listed}{more}."]


def residuals(body: Body, markers: Markers, poses: Poses, tracked: Bool[np.ndarray, " frame"]) -> dict[str, float]:
    """Root mean square distance of each marker from its place, over tracked frames in which it is near that, metres."""
    off = np.linalg.norm(places(body, markers.rows, poses) - markers.points, axis=-1)
    use = markers.seen & tracked[:, None] & (off < CLOSE)
    mean = np.where(use, off, 0) ** 2
    found = np.sqrt(mean.sum(0) / np.maximum(use.sum(0), 1))
    return {name: float(r) for name, r, n in zip(markers.names, found, use.sum(0)) if n}


def _residuals(found: dict[str, float]) -> list[str]:
    """A note on markers far from their fitted places."""
    bad = sorted((name for name in found if found[name] > FAR), key=lambda n: -found[n])
    if not bad:
        return []
    listed = ", ".join(f"'{n}' {1000 * found[n]:.0f} mm" for n in bad[:SHOWN])
    more = f" and {len(bad) - SHOWN} more" if len(bad) > SHOWN else ""
    usual = 1000 * float(np.median(list(found.values())))
    return [f"Markers that move on the body, or have a wrong name (the others: {usual:.0f} mm): {listed}{more}."]


def name_notes(named: Named) -> list[str]:
    """Notes on the subject whose markers are used, and the sets that know their names."""
    notes = []
    if named.others:
        others = ", ".join(f"'{s}'" if s else "nobody named" for s in named.others)
        count = sum(map(len, named.others.values()))
        notes.append(
            f"Named points of {1 + len(named.others)} subjects: '{named.subject}' is tracked, "
            f"the {count} of {others} are left out."
        )
    titles = [title for title in named.known.titles if title != USUAL]
    if titles:
        notes.append(remark(f"The names of points are from: {'; '.join(named.known.titles)}."))
    return notes


def _unknown(body: Body, table: MarkerTable, poses: Poses, tracked) -> list[str]:
    """Notes on names that the body does not know: their counts, and their places on the body."""
    other = table.unknown
    if not other.names:
        return []
    nobody = [k for k, n in enumerate(other.names) if nobodys(n)]
    rest = [k for k in range(len(other.names)) if k not in nobody]
    notes, hints = [], _where(body, table, poses, tracked, rest)
    found = []
    for k in rest:
        text = f"was not used ({int(other.seen[:, k].sum())} times): unknown name"
        if k in hints:
            text += f"; it sits where {hints[k]} belongs"
        found.append((f"'{other.names[k]}'", text))
    notes += in_few_lines(found, "markers were not used", "Marker ")
    if hints:
        line = " ".join(f"'{other.names[k]}={site}'" for k, site in hints.items())
        notes.append(f"By their positions: --features.names {line}")
    elif rest and not tracked.any():
        line = " ".join(f"'{other.names[k]}=...'" for k in rest)
        notes.append(f"State which points of the body or limbs they are (docs/logs.md): --features.names {line}")
    if nobody:
        names = [other.names[k] for k in nobody]
        listed = ", ".join(f"'{n}'" for n in names[:SHOWN]) + (", ..." if len(names) > SHOWN else "")
        notes.append(f"{len(nobody)} unnamed points were not used ({listed}).")
    return notes


def _where(body: Body, table: MarkerTable, poses: Poses, tracked, which: list[int]) -> dict[int, str]:
    """Point of the body next to each of some unknown names, if it is near and no other name is there."""
    t, other = body.topology, table.unknown
    names = (*t.sites, *t.centres)
    rows = np.array([k for k, name in enumerate(names) if OWN not in name], np.int64)
    if not tracked.any() or not len(rows) or not which:
        return {}
    at, mine = places(body, rows, poses), table.markers
    taken = np.zeros(len(rows), bool)
    for k in np.flatnonzero(mine.seen.mean(0) > 0.5):
        away = np.linalg.norm(at - mine.points[:, k][:, None], axis=-1)
        use = mine.seen[:, k] & tracked
        if use.any():
            near = np.median(away[use], 0)
            taken[np.argmin(near)] |= near.min() < HINT
    found = []
    for k in which:
        use = other.seen[:, k] & tracked
        if use.mean() > HINTED:
            off = np.median(np.linalg.norm(at[use] - other.points[use, k][:, None], axis=-1), 0)
            found += [(off[i], k, i) for i in np.flatnonzero(~taken & (off < HINT))]
    hints: dict[int, str] = {}
    for _, k, i in sorted(found):
        if k not in hints and names[rows[i]] not in hints.values():
            hints[k] = names[rows[i]]
    return hints
