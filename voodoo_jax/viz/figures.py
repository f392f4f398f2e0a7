"""Pictures of tracks: the cloud, and the body laid over it, from the front and from the side. No global plot state."""

import os
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, QhullError

from voodoo_jax.exporters.frames import forwards
from voodoo_jax.exporters.limb_shapes import limb_rings, side_of
from voodoo_jax.records.recording import Frame, Recording
from voodoo_jax.records.stretches import spread
from voodoo_jax.records.tracks import STATUS_WORDS, Tracks, given_from
from voodoo_jax.storage.atomic import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 72  # matplotlib's inline backend's own
LABELS = {"cloud": "cloud, from the sensor", "front": "body, from the sensor", "side": "body, from the side"}
MARK: dict = {"marker": "D", "markersize": 3.2, "color": "#f2c200", "markeredgecolor": "black", "markeredgewidth": 0.5}
RAY_COLOUR, RAY_LENGTH = "#2a9d4a", 8.0  # metres
# origin and axes (rows: right, up, away) of a drawing, and which of them are a panel's right, up and away
Drawing = tuple[np.ndarray, np.ndarray, tuple[int, int, int]]
SIDE_MAPS = {"left": "Oranges", "right": "Blues", "middle": "Greys"}  # of matplotlib
PERSON_MAPS = ("Greens", "Purples", "YlOrBr", "RdPu", "GnBu")  # of the second person and so on


class ShownFigure(Figure):
    """A figure without global plot state that a notebook shows as the last value of a cell."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=DPI)
        return stream.getvalue()


def picture(
    tracks: Tracks | Sequence[Tracks],
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
    tracks: Tracks | Sequence[Tracks],
    recording: Recording,
    frames: int = 4,
    truth: Float[np.ndarray, "frame joint 3"] | None = None,
) -> Figure:
    """Figure of evenly spaced frames, one column each: the camera image with the body over it, if the recording has
    images; the cloud; the body over the cloud; the body from the side.

    The front view is that of the first sensor, the side view that from the right edge of its image; without sensors
    (markers alone) it is that of the body, and there is no cloud. Axes in metres, equal scale; each column's window
    follows the body. Left limbs are warm, right ones cool. Of several people the first one is drawn so, the others each
    in a colour of their own, left limbs lighter. truth: joint centres of the first for the frames of `tracks`, metres
    in the fixed frame, drawn as crosses. Raises ValueError if there is no frame or the truth has another number of
    frames.
    """
    people = [tracks] if isinstance(tracks, Tracks) else list(tracks)
    tracks = people[0]
    if not len(recording) or not len(tracks.time_ns):
        raise ValueError(f"nothing to draw: {recording.path} or its tracks have no frame")
    if truth is not None and len(truth) != len(tracks.time_ns):
        raise ValueError(f"truth has {len(truth)} frames, the tracks have {len(tracks.time_ns)}")
    chosen, people = spread(len(tracks.time_ns), frames), [given_from(one, -recording.origin) for one in people]
    tracks = people[0]
    truth = None if truth is None else truth - recording.origin
    stamps = np.array([frame.time_ns for frame in recording])
    nearest = [recording.frames[int(np.abs(stamps - tracks.time_ns[i]).argmin())] for i in chosen]
    middle, axes3 = _view(tracks, recording, nearest, int(chosen[len(chosen) // 2]))
    windows = _windows(people, nearest, chosen, middle, axes3)
    rows, tall = _rows(nearest, windows[0])
    width = 2.9
    height = 1.1 + width * sum(tall)  # with room under the axes for the labels
    figure = ShownFigure(figsize=(width * len(chosen) + 0.6, height))
    figure.set_layout_engine("constrained")
    grid = figure.subplots(len(rows), len(chosen), squeeze=False, height_ratios=tall)
    colours = [limb_colours(one.body.topology.limbs, number) for number, one in enumerate(people)]
    start = int(recording.frames[0].time_ns)
    for column, (i, frame, window) in enumerate(zip(chosen, nearest, windows)):
        for ax, (view, what) in zip(grid[:, column], rows):
            if what == "image":
                _draw_image(ax, frame, people, int(i))
                continue
            drawing = (middle, axes3, view)
            _draw_measured(ax, frame, drawing, window, marks=what != "cloud" or len(frame.points) == 0)
            if what != "cloud":
                for one, own in zip(people, colours):
                    _draw_tracked(ax, one, int(i), drawing, own, truth if one is tracks else None)
            _frame_axes(ax, window, view, LABELS[what], column == 0, bool(recording.sensors))
        grid[0, column].set_title(_title(tracks, int(i), start), fontsize=9)
    _legend(figure, people, nearest, truth is not None)
    return figure


def _rows(frames: list[Frame], window: np.ndarray) -> tuple[list[tuple[tuple[int, int, int], str]], list[float]]:
    """Views of a picture's rows, and their heights as shares of the width, so that panels fill their cells."""
    spans = window[1] - window[0]
    tall = min(spans[1] / max(spans[0], spans[2]), 1.6)
    rows, heights = [((0, 1, 2), "front"), ((2, 1, 0), "side")], [tall, tall]
    if any(len(frame.points) for frame in frames):  # else there are markers alone, which are drawn with the body
        rows.insert(0, ((0, 1, 2), "cloud"))
        heights.append(tall)
    image = next((frame.pictures[0].unpack()[0].shape for frame in frames if frame.pictures), None)
    if image is not None:
        rows.insert(0, ((0, 1, 2), "image"))
        heights.insert(0, image[0] / image[1])
    return rows, heights


def _draw_image(ax: "Axes", frame: Frame, people: list[Tracks], i: int) -> None:
    """The first camera's image, with the bodies over it."""
    from voodoo_jax.viz.overlay import drawn_over

    ax.set_axis_off()
    if frame.pictures:
        ax.imshow(drawn_over(frame.pictures[0], people, [i] * len(people))[..., ::-1])


def _frame_axes(ax: "Axes", window, view: tuple[int, int, int], label: str, first: bool, sensors: bool) -> None:
    """Region, scale and labels of a panel; `first` of its row."""
    ax.set_xlim(window[0, view[0]], window[1, view[0]])
    ax.set_ylim(window[0, view[1]], window[1, view[1]])
    ax.set_aspect("equal")
    ax.tick_params(labelsize=7, labelleft=first)
    if first:
        ax.set_ylabel(f"{label if sensors else label.replace('sensor', 'front')}\nup, m", fontsize=8)
    away = "away from the sensor, m" if sensors else "backwards, m"
    ax.set_xlabel("right, m" if view[0] == 0 else away, fontsize=8)


def _legend(figure: "Figure", people: list[Tracks], frames: list[Frame], truth: bool) -> None:
    """Meaning of colours and signs, above and below the panels."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    sides = {side_of(name) for name in people[0].body.topology.limbs}
    handles: list[Patch | Line2D] = []
    if {"left", "right"} <= sides:
        handles += [Patch(color=_shades(side)[0], label=side, alpha=0.7) for side in ("left", "right")]
    for number in range(1, len(people)):
        handles.append(Patch(color=_shades("", number)[0], label=f"person {number + 1}", alpha=0.7))
    if any(len(frame.pairs.points) for frame in frames):
        handles.append(Line2D([], [], linestyle="", label="markers", **MARK))
    if any(len(frame.rays.origins) for frame in frames):
        handles.append(Line2D([], [], color=RAY_COLOUR, label="lines of sight of 2D features"))
    if handles:
        figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8, frameon=False)
    legend = "" if people[0].joint_confidence is None else "; red: low confidence"
    figure.supxlabel(f"circles: joint centres{legend}" + ("; crosses: truth" if truth else ""), fontsize=8)


def _draw_measured(ax: "Axes", frame: Frame, drawing: Drawing, window, marks: bool) -> None:
    """Draws the cloud; with `marks` also named 3D points, and lines of sight of 2D features."""
    middle, axes3, (h, v, depth) = drawing
    points = (frame.points.astype(float) - middle) @ axes3.T
    # the farther from the sensor, the lighter; nearer points over farther ones
    order = np.argsort(-points[:, 2] if depth == 2 else points[:, 0])
    shade = np.clip((points[order, 2] - window[0, 2]) / (window[1, 2] - window[0, 2]), 0, 1)
    ax.scatter(
        points[order, h], points[order, v], s=2.2, c=0.25 + 0.55 * shade, cmap="gray", vmin=0, vmax=1,
        linewidths=0, rasterized=True,
    )  # fmt: skip
    if not marks:
        return
    if len(frame.pairs.points):
        at = (frame.pairs.points.astype(float) - middle) @ axes3.T
        ax.plot(at[:, h], at[:, v], linestyle="", zorder=850, **MARK)
    for origin, direction in zip(frame.rays.origins.astype(float), frame.rays.directions.astype(float)):
        ends = (np.stack([origin, origin + RAY_LENGTH * direction]) - middle) @ axes3.T
        ax.plot(ends[:, h], ends[:, v], color=RAY_COLOUR, linewidth=0.7, zorder=840)


def _draw_tracked(ax: "Axes", tracks: Tracks, i: int, drawing: Drawing, colours, truth) -> None:
    """Draws the body, the true joints if they are given, or a label if there is no pose."""
    middle, axes3, view = drawing
    h, v, _ = view
    if np.isfinite(tracks.translation[i]).any():
        draw_body(ax, tracks, i, middle, axes3, view, colours)
    elif tracks.person == 1:
        box = dict(facecolor="white", edgecolor="none", alpha=0.8)
        ax.text(0.5, 0.5, "no pose", transform=ax.transAxes, ha="center", va="center", bbox=box)
    if truth is not None:
        cross = (np.asarray(truth[i], float) - middle) @ axes3.T
        ax.plot(cross[:, h], cross[:, v], "x", color="black", markersize=5, markeredgewidth=1.0, zorder=900)


def _title(tracks: Tracks, i: int, start: int) -> str:
    status = int(tracks.status[i])
    words = STATUS_WORDS.get(status, f"status {status}")
    residual = tracks.evidence.residual[i]
    error = f"residual {1000 * residual:.0f} mm" if np.isfinite(residual) else "no residual"
    return f"{(int(tracks.time_ns[i]) - start) / 1e9:.2f} s, {words}\n{error}"


def _view(tracks: Tracks, recording: Recording, frames: list[Frame], i: int) -> tuple[np.ndarray, np.ndarray]:
    """Origin of the drawing (fixed frame) and its axes as rows: right, up, away from the sensor; without a sensor, away
    from the body's front in frame `i` of the tracks."""
    up = np.asarray(recording.up if tracks.up is None else tracks.up, float)
    up = up / np.linalg.norm(up)
    origin = next((frame.origins[0] for frame in frames if len(frame.origins)), None)
    sensor = np.zeros(3) if origin is None else np.asarray(origin, float)
    posed = tracks.translation[np.isfinite(tracks.translation).all(2)]
    clouds = [frame.points for frame in frames if len(frame.points)]
    if len(posed):
        target = posed.mean(0).astype(float)
    else:
        target = np.median(np.concatenate(clouds), 0).astype(float) if clouds else sensor + [1.0, 0, 0]
    away = target - sensor
    if origin is None and (ahead := forwards(tracks, i)) is not None:
        away = -ahead
    away = away - up * (away @ up)
    if np.linalg.norm(away) < 1e-6:  # the sensor looks straight up or down: any horizontal direction
        away = np.cross(up, [0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0])
    away = away / np.linalg.norm(away)
    # heights and distances count from the foot of the sensor
    return sensor - up * (sensor @ up), np.stack([np.cross(away, up), up, away])


def _windows(people: list[Tracks], frames: list[Frame], chosen, middle, axes3) -> list[np.ndarray]:
    """Drawn region of each frame [low or high, right/up/away] in metres, all of one size and height: around the bodies
    in that frame; without a pose, around those of the nearest frame; without any pose, around the clouds."""
    every = [np.concatenate([limb_rings(tracks, int(i)).reshape(-1, 3) for tracks in people]) for i in chosen]
    rings = [(ring - middle) @ axes3.T for ring in every]
    rings = [ring[np.isfinite(ring).all(1)] for ring in rings]
    bodies = [k for k, ring in enumerate(rings) if len(ring)]
    if bodies:
        low, high = (np.stack([getattr(rings[k], end)(0) for k in bodies]) for end in ("min", "max"))
        low, high = low - 0.25, high + 0.25
    else:
        clouds = [frame.points for frame in frames if len(frame.points)] or [np.zeros((1, 3))]
        seen = (np.concatenate(clouds).astype(float) - middle) @ axes3.T
        low, high = np.percentile(seen, [1], axis=0) - 0.1, np.percentile(seen, [99], axis=0) + 0.1
    # both kinds of panel get the same width, and all frames the same height
    half = (high - low)[:, [0, 2]].max() / 2
    out = []
    for k in range(len(chosen)):
        near = int(np.abs(np.array(bodies) - k).argmin()) if bodies else 0
        centre = (low[near] + high[near]) / 2
        window = np.stack([centre - half, centre + half])
        window[:, 1] = low[:, 1].min(), high[:, 1].max()
        out.append(window)
    return out


# 7 parameters: what is drawn, where and how
def draw_body(ax: "Axes", tracks: Tracks, i: int, middle, axes3, view: tuple[int, int, int], colours) -> None:
    """Draws the limbs' outlines, farthest first, and joint centres in frame `i`; `view`: axes for right, up and
    away."""
    h, v, depth = view
    rings = (limb_rings(tracks, i) - middle) @ axes3.T
    sign = -1 if depth == 2 else 1  # farthest first: away from the sensor, or the far side of the side view
    near = np.clip(400 + 50 * sign * rings[:, :, depth].mean(1), 10, 790)  # by metres, for several bodies
    for limb in np.argsort(near):
        flat = rings[limb][:, [h, v]]
        if not np.isfinite(flat).all():
            continue
        try:
            outline = flat[ConvexHull(flat).vertices]
        except QhullError:  # a limb without extent in this view
            continue
        ax.fill(*outline.T, facecolor=colours[limb], alpha=0.45, linewidth=0, zorder=float(near[limb]))
        ax.fill(*outline.T, facecolor="none", edgecolor=colours[limb], linewidth=1.1, zorder=float(near[limb]))
    joints = (np.asarray(tracks.joints[i], float) - middle) @ axes3.T
    sure = np.ones(len(joints)) if tracks.joint_confidence is None else tracks.joint_confidence[i]
    pale = np.where(np.isfinite(sure), sure, 1.0)
    white_to_red = np.stack([np.ones_like(pale), pale, pale], 1)
    ax.scatter(joints[:, h], joints[:, v], s=16, c=white_to_red, edgecolors="black", linewidths=1.0, zorder=800)


def _shades(side: str, number: int = 0) -> list:
    """Colours of the limbs of a side, distinct for neighbours; `number` of the person, from 0."""
    from matplotlib import colormaps

    if number:
        bright = 0.25 if side == "left" else 0.0
        return [colormaps[PERSON_MAPS[(number - 1) % len(PERSON_MAPS)]](s - bright) for s in (0.75, 0.95, 0.6)]
    return [colormaps[SIDE_MAPS[side]](share) for share in (0.62, 0.85, 0.45)]


def limb_colours(limbs: tuple[str, ...], number: int = 0) -> list:
    """One colour per limb: warm for the left, cool for the right, grey between; for a body without sides, distinct for
    neighbours in the list. Shades of one colour for each further person (`number` from 1)."""
    from matplotlib import colormaps

    sides = [side_of(name) for name in limbs]
    if number:
        return [_shades(side, number)[sides[:i].count(side) % 3] for i, side in enumerate(sides)]
    if not {"left", "right"} <= set(sides):
        table = colormaps["tab20"]
        return [table(i % 20) for i in range(len(limbs))]
    return [_shades(side)[sides[:i].count(side) % 3] for i, side in enumerate(sides)]
