"""Pictures of tracks: the cloud, and the body laid over it, from the front and from the side. No global plot state."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from voodoo_jax.records.recording import Frame, Recording
from voodoo_jax.records.tracks import Status, Tracks, given_from
from voodoo_jax.storage.atomic import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STATUS_WORDS: dict[int, str] = {
    Status.TRACKED: "tracked",
    Status.NOT_STARTED: "not started",
    Status.NO_DATA: "no data",
    Status.LOST: "lost",
    Status.FEATURES: "features only",
}
LABELS = {"cloud": "cloud, from the sensor", "front": "body, from the sensor", "side": "body, from the side"}
RING = 32  # points on each end ellipse


def spread(length: int, count: int) -> Int[np.ndarray, " chosen"]:
    """Indices of `count` evenly spaced frames of `length`."""
    return np.unique(np.linspace(0, length - 1, max(1, min(count, length))).round().astype(int))


def picture(
    tracks: Tracks,
    recording: Recording,
    path: str | os.PathLike[str],
    frames: int = 4,
    truth: Float[np.ndarray, "frame joint 3"] | None = None,
) -> Path:
    """Writes a PNG of `frames` evenly spaced frames (see `show`) and returns its path. Raises OSError, ValueError."""
    path = Path(path)
    figure = show(tracks, recording, frames, truth)
    with replacing(path) as partial:
        figure.savefig(partial, format="png", dpi=110)
    return path


def show(
    tracks: Tracks,
    recording: Recording,
    frames: int = 4,
    truth: Float[np.ndarray, "frame joint 3"] | None = None,
) -> "Figure":
    """Figure of evenly spaced frames, one column each: cloud, body over the cloud, body from the side.

    The front view is that of the first sensor, the side view that from the right edge of its image; axes in metres,
    equal scale. truth: joint centres for the frames of `tracks`, metres in the fixed frame, drawn as crosses. Raises
    ValueError if there is no frame or the truth has another number of frames.
    """
    from matplotlib.figure import Figure

    if not len(recording) or not len(tracks.time_ns):
        raise ValueError(f"nothing to draw: {recording.path} or its tracks have no frame")
    if truth is not None and len(truth) != len(tracks.time_ns):
        raise ValueError(f"truth has {len(truth)} frames, the tracks have {len(tracks.time_ns)}")
    chosen, tracks = spread(len(tracks.time_ns), frames), given_from(tracks, -recording.origin)
    truth = None if truth is None else truth - recording.origin
    stamps = np.array([frame.time_ns for frame in recording])
    nearest = [recording.frames[int(np.abs(stamps - tracks.time_ns[i]).argmin())] for i in chosen]
    middle, axes3 = _view(tracks, recording, nearest)
    window = _window(tracks, nearest, chosen, middle, axes3)

    # room under the axes for the labels; height follows the drawn region so that panels fill their cells
    spans = window[1] - window[0]
    width = 2.9
    figure = Figure(figsize=(width * len(chosen) + 0.6, 0.9 + 3 * width * min(spans[1] / max(spans[0], spans[2]), 1.6)))
    figure.set_layout_engine("constrained")
    grid = figure.subplots(3, len(chosen), squeeze=False)
    colours = _colours(len(tracks.body.topology.limbs))
    start = int(recording.frames[0].time_ns)
    for column, (i, frame) in enumerate(zip(chosen, nearest)):
        points = (frame.points.astype(float) - middle) @ axes3.T
        posed = bool(np.isfinite(tracks.translation[i]).any())
        for row, ((h, v, depth), what) in enumerate((((0, 1, 2), "cloud"), ((0, 1, 2), "front"), ((2, 1, 0), "side"))):
            ax = grid[row, column]
            # the farther from the sensor, the lighter; nearer points over farther ones
            order = np.argsort(-points[:, 2] if depth == 2 else points[:, 0])
            shade = np.clip((points[order, 2] - window[0, 2]) / spans[2], 0, 1)
            ax.scatter(
                points[order, h], points[order, v], s=2.2, c=0.25 + 0.55 * shade, cmap="gray", vmin=0, vmax=1,
                linewidths=0, rasterized=True,
            )  # fmt: skip
            if what != "cloud" and posed:
                _draw_body(ax, tracks, int(i), middle, axes3, (h, v, depth), colours)
            if what != "cloud" and truth is not None:
                cross = (np.asarray(truth[i], float) - middle) @ axes3.T
                ax.plot(cross[:, h], cross[:, v], "x", color="black", markersize=5, markeredgewidth=1.0, zorder=900)
            if what != "cloud" and not posed:
                box = dict(facecolor="white", edgecolor="none", alpha=0.8)
                ax.text(0.5, 0.5, "no pose", transform=ax.transAxes, ha="center", va="center", bbox=box)
            ax.set_xlim(window[0, h], window[1, h])
            ax.set_ylim(window[0, v], window[1, v])
            ax.set_aspect("equal")
            ax.tick_params(labelsize=7)
            if column == 0:
                ax.set_ylabel(f"{LABELS[what]}\nup, m", fontsize=8)
            else:
                ax.tick_params(labelleft=False)
            ax.set_xlabel("right, m" if h == 0 else "away from the sensor, m", fontsize=8)
        grid[0, column].set_title(_title(tracks, int(i), start), fontsize=9)
    told = "" if tracks.joint_confidence is None else ", the redder the more doubtful"
    figure.supxlabel(f"circles: joint centres{told}" + ("" if truth is None else "; crosses: truth"), fontsize=8)
    return figure


def _title(tracks: Tracks, i: int, start: int) -> str:
    status = int(tracks.status[i])
    words = STATUS_WORDS.get(status, f"status {status}")
    residual = tracks.residual[i]
    error = f"residual {1000 * residual:.0f} mm" if np.isfinite(residual) else "no residual"
    return f"{(int(tracks.time_ns[i]) - start) / 1e9:.2f} s, {words}\n{error}"


def _view(tracks: Tracks, recording: Recording, frames: list[Frame]) -> tuple[np.ndarray, np.ndarray]:
    """Origin of the drawing (fixed frame) and its axes as rows: right, up, away from the sensor."""
    up = np.asarray(recording.up, float) / np.linalg.norm(recording.up)
    sensor = np.asarray(frames[0].origins[0] if len(frames[0].origins) else np.zeros(3), float)
    posed = tracks.translation[np.isfinite(tracks.translation).all(2)]
    clouds = [frame.points for frame in frames if len(frame.points)]
    if len(posed):
        target = posed.mean(0).astype(float)
    else:
        target = np.median(np.concatenate(clouds), 0).astype(float) if clouds else sensor + [1.0, 0, 0]
    away = target - sensor
    away = away - up * (away @ up)
    if np.linalg.norm(away) < 1e-6:  # the sensor looks straight up or down: any horizontal direction
        away = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0])
    away = away / np.linalg.norm(away)
    # heights and distances count from the foot of the sensor
    return sensor - up * (sensor @ up), np.stack([np.cross(away, up), up, away])


def _window(tracks: Tracks, frames: list[Frame], chosen, middle, axes3) -> np.ndarray:
    """Drawn region [low or high, right/up/away] in metres: around the body in all frames, else around the clouds."""
    rings = np.concatenate([_rings(tracks, int(i)).reshape(-1, 3) for i in chosen])
    rings = rings[np.isfinite(rings).all(1)]
    if len(rings):
        seen = (rings - middle) @ axes3.T
        low, high = seen.min(0) - 0.25, seen.max(0) + 0.25
    else:
        clouds = [frame.points for frame in frames if len(frame.points)] or [np.zeros((1, 3))]
        seen = (np.concatenate(clouds).astype(float) - middle) @ axes3.T
        low, high = np.percentile(seen, 1, axis=0) - 0.1, np.percentile(seen, 99, axis=0) + 0.1
    # both kinds of panel get the same width
    half = max(high[0] - low[0], high[2] - low[2]) / 2
    for k in (0, 2):
        centre = (low[k] + high[k]) / 2
        low[k], high[k] = centre - half, centre + half
    return np.stack([low, high])


def _rings(tracks: Tracks, i: int) -> np.ndarray:
    """Points on both end ellipses of all limbs [limb, 2 RING, 3] in the fixed frame, metres; NaN: not there."""
    sizes = np.asarray(tracks.body.sizes, float)[:, :, None]
    angle = np.linspace(0, 2 * np.pi, RING, endpoint=False)
    c, s, flat = np.cos(angle), np.sin(angle), np.zeros((len(sizes), RING))
    bottom = np.stack([sizes[:, 0] * c, sizes[:, 1] * s, flat], -1)
    top = np.stack([sizes[:, 2] * c, sizes[:, 3] * s, flat + sizes[:, 4]], -1)
    # a limb that is not there stays NaN by its place
    turn = np.where(np.isfinite(tracks.rotation[i]), tracks.rotation[i], 1.0).astype(float)
    turn = Rotation.from_quat(turn, scalar_first=True).as_matrix()
    return np.concatenate([bottom, top], 1) @ turn.transpose(0, 2, 1) + tracks.translation[i][:, None]


def _draw_body(ax: "Axes", tracks: Tracks, i: int, middle, axes3, view: tuple[int, int, int], colours) -> None:
    h, v, depth = view
    rings = (_rings(tracks, i) - middle) @ axes3.T
    sign = -1 if depth == 2 else 1  # farthest first: away from the sensor, or the far side of the side view
    order = np.argsort(sign * rings[:, :, depth].mean(1))
    for rank, limb in enumerate(order):
        flat = rings[limb][:, [h, v]]
        if not np.isfinite(flat).all():
            continue
        try:
            outline = flat[ConvexHull(flat).vertices]
        except QhullError:  # a limb without extent in this view
            continue
        ax.fill(*outline.T, facecolor=colours[limb], alpha=0.45, linewidth=0, zorder=10 + rank)
        ax.fill(*outline.T, facecolor="none", edgecolor=colours[limb], linewidth=1.1, zorder=10 + rank)
    joints = (np.asarray(tracks.joints[i], float) - middle) @ axes3.T
    sure = np.ones(len(joints)) if tracks.joint_confidence is None else tracks.joint_confidence[i]
    pale = np.where(np.isfinite(sure), sure, 1.0)
    white_to_red = np.stack([np.ones_like(pale), pale, pale], 1)
    ax.scatter(joints[:, h], joints[:, v], s=16, c=white_to_red, edgecolors="black", linewidths=1.0, zorder=800)


def _colours(count: int) -> list:
    """One colour per limb, neighbours in the list well apart."""
    from matplotlib import colormaps

    table = colormaps["tab20"]
    return [table(i % 20) for i in range(count)]
