"""Small SVG drawings of tracks or bodies: a body at some times, tracked times, two bodies."""

from collections.abc import Iterable, Sequence
from itertools import chain

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from voodoo_jax.exporters.frames import seconds, upright
from voodoo_jax.exporters.limb_shapes import limb_rings, rings, side_of
from voodoo_jax.model.body import Body
from voodoo_jax.records.stretches import stretches
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.viz.figures import spread

CLASSES = {"left": "l", "right": "r", "middle": "m"}  # of outlines, for a page's style sheet
CELL = 100.0  # width of a cell in the drawing's units; numbers are rounded to whole ones
COLUMNS = 120  # of a time line
MARGIN = 0.06  # of the largest extent, around the drawn bodies


def strip(tracks: Tracks, count: int = 5) -> str:
    """The body in `count` evenly spread tracked frames side by side, on one scale, seen from its front in the middle
    one; "" without any pose."""
    there = np.isfinite(tracks.translation).all(2).sum(1) > 0
    posed = np.flatnonzero(there & tracks.tracked if (there & tracks.tracked).any() else there)
    if not len(posed):
        return ""
    chosen = posed[spread(len(posed), count)]
    axes = _front(tracks, int(posed[len(posed) // 2]))
    return _drawn([limb_rings(tracks, int(i)) @ axes.T for i in chosen], tracks.body.topology.limbs)


def compared(before: Body, after: Body) -> str:
    """Two bodies with the same limbs in their rest poses over each other, from the front and from the left; the first
    has the class "before"."""
    views = np.array([[[0.0, 1, 0], [0, 0, 1], [-1, 0, 0]], [[-1.0, 0, 0], [0, 0, 1], [0, -1, 0]]])
    there = [
        [rings(b, np.asarray(b.rest.rotation), np.asarray(b.rest.translation)) @ v.T for v in views]
        for b in (after, before)
    ]
    return _drawn(there[0], after.topology.limbs, there[1])


def _drawn(
    bodies: Sequence[Float[np.ndarray, "limb point 3"]],
    limbs: tuple[str, ...],
    others: Sequence[Float[np.ndarray, "limb point 3"]] = (),
) -> str:
    """Draws bodies side by side, and others over them: outlines of their limbs, farthest first; right, up, away,
    metres."""
    seen = [np.concatenate(pair) for pair in zip(bodies, others)] if others else bodies
    every = [points[np.isfinite(points).all(2)] for points in seen]
    extent = np.max([np.ptp(points[:, :2], axis=0) for points in every], axis=0)
    margin = MARGIN * float(extent.max())
    width, height = extent + 2 * margin
    scale = CELL / max(width, 1e-6)
    parts = []
    for k, (body, points) in enumerate(zip(bodies, every)):
        low, high = points.min(0), points.max(0)
        origin = np.array([(low[0] + high[0] - width) / 2, low[1] - margin + height])  # all stand on one line
        shapes = [_outlines(body, limbs, origin, scale)]
        shapes += [_outlines(others[k], limbs, origin, scale, "before")] if others else []
        parts.append(f'<g transform="translate({k * CELL:g},0)">{"".join(chain(*shapes))}</g>')
    view = f"0 0 {CELL * len(bodies):g} {height * scale:.0f}"
    return f'<svg class="strip" viewBox="{view}" role="img">{"".join(parts)}</svg>'


def time_line(tracks: Tracks) -> str:
    """Tracked or not, and the confidence, over time; a bar as wide as its place."""
    time = seconds(tracks)
    if not len(time):
        return ""
    share = time / time[-1] if time[-1] > 0 else np.linspace(0, 1, len(time))
    column = np.minimum((share * COLUMNS).astype(int), COLUMNS - 1)
    rectangles = []
    for start, stop, level in _runs([_level(tracks, np.flatnonzero(column == k)) for k in range(COLUMNS)]):
        rectangles.append(f'<rect class="s{level}" x="{start}" width="{stop - start}" height="8"/>')
    return (
        f'<svg class="line" viewBox="0 0 {COLUMNS} 8" preserveAspectRatio="none" role="img">{"".join(rectangles)}</svg>'
    )


def untracked(tracks: Tracks) -> list[tuple[float, float]]:
    """Intervals in which nothing is tracked: first and last stamp, seconds after the first frame."""
    time = seconds(tracks)
    return [(float(time[a]), float(time[b - 1])) for a, b in stretches(~tracks.tracked)]


def _level(tracks: Tracks, frames: np.ndarray) -> int:
    """-1: no frame, 0: not tracked, 1 to 4: tracked, rising with the confidence."""
    if not len(frames):
        return -1
    if not tracks.tracked[frames].any():
        return 0
    sure = tracks.confidence[frames][tracks.tracked[frames]]
    sure = sure[np.isfinite(sure)]
    return 4 if not len(sure) else 1 + int(min(3, max(0, 4 * float(sure.mean()))))


def _runs(levels: list[int]) -> Iterable[tuple[int, int, int]]:
    """Start, end and value of stretches of one value; a column without a frame belongs to the one before it."""
    filled = np.array(levels)
    for k in range(1, len(filled)):
        filled[k] = filled[k - 1] if filled[k] < 0 else filled[k]
    edges = [0, *(np.flatnonzero(np.diff(filled)) + 1).tolist(), len(filled)]
    return [(a, b, int(filled[a])) for a, b in zip(edges[:-1], edges[1:])]


def _front(tracks: Tracks, i: int) -> Float[np.ndarray, "3 3"]:
    """Rows: right, up and away, for a view of the body's front in frame `i`."""
    turn = upright(tracks)
    up = turn.T[:, 2]
    rest = Rotation.from_quat(np.asarray(tracks.body.rest.rotation, float)[0], scalar_first=True)
    away = turn.T[:, 0]
    if np.isfinite(tracks.rotation[i, 0]).all():
        now = Rotation.from_quat(tracks.rotation[i, 0].astype(float), scalar_first=True)
        away = -(now * rest.inv()).apply([1.0, 0, 0])  # the body's forward axis is x in its rest pose
    away = away - up * (away @ up)
    if np.linalg.norm(away) < 0.1:  # who lies shows no front: any horizontal direction
        away = turn.T[:, 0]
    away = away / np.linalg.norm(away)
    return np.stack([np.cross(away, up), up, away])


def _outlines(
    body: np.ndarray, limbs: tuple[str, ...], origin: np.ndarray, scale: float, look: str = ""
) -> Iterable[str]:
    """Polygons of limbs; `look` is their class, by default that of their side."""
    for limb in map(int, np.argsort(-body[:, :, 2].mean(1))):
        if not np.isfinite(body[limb]).all():
            continue
        flat = (body[limb, :, :2] - origin) * [scale, -scale]
        try:
            corners = flat[ConvexHull(flat).vertices]
        except QhullError:  # a limb without extent in this view
            continue
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        yield f'<polygon class="{look or CLASSES[side_of(limbs[limb])]}" points="{path}"/>'
