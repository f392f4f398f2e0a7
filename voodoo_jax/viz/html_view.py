"""A log and its tracks as one self-contained HTML file: cloud, bodies, time line, plots; opens offline."""

import base64
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, Int64
from scipy.spatial.transform import Rotation

from voodoo_jax.exporters.frames import upright
from voodoo_jax.exporters.limb_shapes import profile, side_of
from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.records.notes import filled, for_script
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.tracks import STATUS_WORDS, Tracks, expected_share
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.viz.overlay import drawn_over
from voodoo_jax.viz.report_page import template

MOST_FRAMES = 900  # of a longer log every second one is shown, every third, ...
POINTS = 700_000  # of all frames together: 6 bytes each, 5.6 MB as text
POINTS_A_FRAME = 4000  # more do not show more
AROUND = 0.35  # metres around the body within which half of a frame's points are taken
REACH = 30.0  # metres from the body beyond which nothing is shown; 16 bits of millimetres hold 32
IMAGES, IMAGE_WIDTH = 150, 320  # of a camera at most, and their width in pixels: 10 kB each
RAY = 6.0  # metres of a line of sight that are drawn


def frames_shown(count: int) -> Int[np.ndarray, " shown"]:
    """The frames of a log that a file shows."""
    return np.arange(0, count, max(1, -(-count // MOST_FRAMES)))


def write_html(people: Sequence[Tracks], frames: Iterable[Frame], path: str | os.PathLike[str]) -> Path:
    """Writes the file and returns its path.

    **Arguments:** `people` tracks of one log, each of another person, the one who is seen longest first; `frames` of
    the log; those whose stamps are not among the tracks' `frames_shown` are left out.

    Raises ValueError if there is nothing to show, OSError.
    """
    first = people[0]
    shown = frames_shown(len(first.time_ns))
    if not len(shown):
        raise ValueError(f"nothing to show: the tracks of {first.source} have no frame")
    turn = upright(first)
    middle = _middle(people, turn)
    seen = _gathered(people, shown, frames, turn, middle)
    blob = _Blob()
    head: dict[str, Any] = {
        "name": Path(first.source).name,
        "about": _about(people),
        "notes": list(first.notes),
        "words": {str(key): word for key, word in STATUS_WORDS.items()},
        "times": [round(float(t), 4) for t in (first.time_ns[shown] - first.time_ns[0]) / 1e9],
        "floor": _floor(people, turn),
        "eye": _eye(seen.origin, middle),
        "images": seen.images,
        "people": [_person(tracks, first.time_ns[shown], turn, blob) for tracks in people],
    }
    millimetres = np.clip(np.round(1000 * np.concatenate([*seen.points, np.zeros((0, 3))])), -32767, 32767)
    tables: dict[str, np.ndarray] = {"points": millimetres.astype(np.int16)}
    tables |= {"marks": np.concatenate([*seen.marks, np.zeros((0, 3))]).astype(np.float32)}
    tables |= {"rays": np.concatenate([*seen.rays, np.zeros((0, 3))]).astype(np.float32)}
    for name, parts in (("starts", seen.points), ("mark_starts", seen.marks), ("ray_starts", seen.rays)):
        tables[name] = np.cumsum([0, *map(len, parts)]).astype(np.uint32)
    head |= {name: blob.add(values) for name, values in tables.items()}
    header, data = for_script(head), base64.b64encode(bytes(blob.data)).decode()
    text = filled(template("view.html"), HEAD=header, BLOB=data)
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
    return Path(path)


class _Blob:
    """All arrays one after the other, each aligned for its type."""

    def __init__(self) -> None:
        self.data = bytearray()

    def add(self, values: np.ndarray) -> dict[str, Any]:
        at = len(self.data)
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        return {"at": at, "bytes": values.nbytes, "kind": values.dtype.str[1:]}


@dataclass
class _Seen:
    """Measurements of the sensors in the frames shown, upright."""

    points: list[np.ndarray] = field(default_factory=list)
    marks: list[np.ndarray] = field(default_factory=list)
    rays: list[np.ndarray] = field(default_factory=list)
    images: dict[int, str] = field(default_factory=dict)  # JPEG as base64 by the number of the frame shown
    origin: np.ndarray | None = None  # of the first sensor


def _gathered(
    people: Sequence[Tracks], shown: np.ndarray, frames: Iterable[Frame], turn: np.ndarray, middle: np.ndarray
) -> _Seen:
    tracks = people[0]
    place = {int(stamp): k for k, stamp in enumerate(tracks.time_ns[shown].tolist())}
    empty = [np.zeros((0, 3))] * len(shown)
    seen = _Seen(list(empty), list(empty), list(empty))
    each = min(POINTS // len(shown), POINTS_A_FRAME)
    for frame in frames:
        k = place.get(frame.time_ns)
        if k is None:
            continue
        if seen.origin is None and len(frame.origins):
            seen.origin = turn @ np.asarray(frame.origins[0], float)
        points = np.asarray(frame.points, float) @ turn.T
        points = points[(np.abs(points - middle) < REACH).all(1) & (np.abs(points) < 32.7).all(1)]
        at = tracks.translation[shown[k]].astype(float) @ turn.T
        at = at[np.isfinite(at).all(1)]
        seen.points[k] = _thinned(points, at, each)
        seen.marks[k] = np.asarray(frame.pairs.points, float) @ turn.T
        start = np.asarray(frame.rays.origins, float)
        ends = np.stack([start, start + RAY * np.asarray(frame.rays.directions, float)], 1)
        seen.rays[k] = ends.reshape(-1, 3) @ turn.T
        if frame.pictures and k % max(1, -(-len(shown) // IMAGES)) == 0:
            rows = [int(rows_at(one.time_ns, np.array([frame.time_ns]))[0]) for one in people]
            seen.images[k] = _small(drawn_over(frame.pictures[0], people, rows))
    return seen


def _small(image: np.ndarray) -> str:
    """A JPEG of some kilobytes, as text."""
    height, width = image.shape[:2]
    scale = min(1.0, IMAGE_WIDTH / width)
    image = cv2.resize(image, (round(scale * width), round(scale * height)), interpolation=cv2.INTER_AREA)
    return base64.b64encode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 70])[1].tobytes()).decode()


def rows_at(stamps: Int64[np.ndarray, " frame"], wanted: Int64[np.ndarray, " shown"]) -> Int[np.ndarray, " shown"]:
    """Rows of a person's frames with these stamps, -1: none."""
    at = np.clip(np.searchsorted(stamps, wanted), 0, max(len(stamps) - 1, 0))
    return np.where(stamps[at] == wanted, at, -1) if len(stamps) else np.full(len(wanted), -1)


def _thinned(points: np.ndarray, limbs: np.ndarray, count: int) -> np.ndarray:
    """At most this many points, half of them near the body if possible."""
    if len(points) <= count:
        return points
    near = np.zeros(len(points), bool)
    if len(limbs):
        near = ((points > limbs.min(0) - AROUND) & (points < limbs.max(0) + AROUND)).all(1)
    spread = lambda rows, n: rows[np.linspace(0, len(rows) - 1, min(n, len(rows))).astype(int)]  # noqa: E731
    body, rest = np.flatnonzero(near), np.flatnonzero(~near)
    own = min(len(body), max(count // 2, count - len(rest)))
    return points[np.concatenate([spread(body, own), spread(rest, count - own)])]


def _person(tracks: Tracks, stamps: np.ndarray, turn: np.ndarray, blob: _Blob) -> dict[str, Any]:
    """One person in the frames shown, matched by stamps."""
    at = rows_at(tracks.time_ns, stamps)
    there = at >= 0
    limbs = tracks.body.limb_count
    q = (Rotation.from_matrix(turn) * rotations(tracks.rotation[at])).as_quat(scalar_first=True).reshape(-1, limbs, 4)
    known = np.isfinite(tracks.rotation[at]).all(2) & np.isfinite(tracks.translation[at]).all(2) & there[:, None]
    poses = np.concatenate([q, tracks.translation[at].astype(float) @ turn.T], 2)
    poses = np.where(known[..., None], poses, np.nan).astype(np.float32)
    sure = limb_confidence(tracks)[at]
    sure = np.where(np.isfinite(sure), np.round(254 * np.clip(np.nan_to_num(sure), 0, 1)), 255).astype(np.uint8)
    return {
        "shapes": [np.round(profile(tracks.body, limb), 4).tolist() for limb in range(limbs)],
        "sides": [side_of(name) for name in tracks.body.topology.limbs],
        "status": [str(int(s)) if ok else "1" for s, ok in zip(tracks.status[at], there)],
        "poses": blob.add(poses),
        "sure": blob.add(sure),
        "residual": blob.add(np.where(there, tracks.evidence.residual[at], np.nan).astype(np.float32)),
        "confidence": blob.add(np.where(there, tracks.confidence[at], np.nan).astype(np.float32)),
        "tracked": blob.add((tracks.tracked[at] & there).astype(np.uint8)),
        "angles": {name: blob.add(values) for name, values in _angles(tracks, at, there).items()},
    }


def _angles(tracks: Tracks, at: np.ndarray, there: np.ndarray) -> dict[str, Float[np.ndarray, " shown"]]:
    """Joint angles in the frames shown, degrees; angles that are never known are left out."""
    angles = tracks.angles()
    table = np.where(there[:, None], np.degrees(angles.table[at]), np.nan).astype(np.float32)
    return {name: values for name, values in zip(angles.columns, table.T) if np.isfinite(values).any()}


def limb_confidence(tracks: Tracks) -> Float[np.ndarray, "frame limb"]:
    """Mean confidence of the joint centres on a limb and at the ends of its child limbs, 0..1; NaN: not known."""
    t, count = tracks.body.topology, tracks.body.limb_count
    found, sure = np.full((len(tracks.time_ns), count), np.nan), tracks.joint_confidence
    for limb in range(0 if sure is None else count):
        near = {limb, *(c for p, c in zip(t.parents, t.children) if p == limb)}
        near |= {p for p, c in zip(t.parents, t.children) if c == limb}
        own = [i for i, carrier in enumerate(t.centre_limbs) if carrier == limb]
        own = own or [i for i, carrier in enumerate(t.centre_limbs) if carrier in near]
        found[:, limb] = np.nan if sure is None else expected_share(sure[:, own])
    return found


def _middle(people: Sequence[Tracks], turn: np.ndarray) -> np.ndarray:
    places = np.concatenate([tracks.translation.reshape(-1, 3) for tracks in people]).astype(float)
    places = places[np.isfinite(places).all(1)]
    return turn @ (np.median(places, 0) if len(places) else np.zeros(3))


def _floor(people: Sequence[Tracks], turn: np.ndarray) -> list[float]:
    """Middle of the grid: under the first person, at the usual height of the person's lowest point."""
    places = people[0].translation.astype(float) @ turn.T
    height = places[..., 2]
    rows = np.isfinite(height).any(1)
    x, y, z = _middle(people, turn)
    low = np.where(np.isfinite(height[rows]), height[rows], np.inf).min(1) if rows.any() else np.array([z - 1.0])
    return [float(x), float(y), float(np.percentile(low, 10))]


def _eye(origin: np.ndarray | None, middle: np.ndarray) -> dict[str, Any]:
    """First viewpoint: on the sensor's side, somewhat above and beside it."""
    away = np.array([-1.0, 0, 0]) if origin is None else origin - middle
    turn = float(np.arctan2(away[1], away[0])) + 0.45
    return {"target": middle.tolist(), "distance": 4.2, "turn": turn, "tilt": 0.3}


def _about(people: Sequence[Tracks]) -> str:
    first = people[0]
    seconds = (first.time_ns[-1] - first.time_ns[0]) / 1e9
    words = [f"{len(first.time_ns)} frames in {seconds:.1f} s", f"{100 * float(first.tracked.mean()):.0f} % tracked"]
    words.append(f"{first.body.scale_name} {float(first.body.scale):.2f} m")
    if len(people) > 1:
        words.append(f"{len(people)} people")
    return ", ".join(words)
