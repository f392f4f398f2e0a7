"""Tracks as one `.npz` file, which holds all of a Tracks and is read by score.py and notebooks."""

import json
import math
import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

from voodoo_jax.geometry.arrays_file import DIGEST, NotArrays, arrays_in, digest
from voodoo_jax.model.body import Body, segment_lengths
from voodoo_jax.model.body_file import BodyFileError, format_body, parse_body
from voodoo_jax.records.tracks import Evidence, Tracks
from voodoo_jax.storage.atomic import replacing
from voodoo_jax.storage.troubles import opened_file
from voodoo_jax.storage.urls import person_place

# kinds of numbers, and the shape: f frames, l limbs, j joint centres, b joints of the body, m markers
FORMS = {
    "time_ns": ("iu", "f"), "rotation": ("f", "fl4"), "translation": ("f", "fl3"), "joints": ("f", "fj3"),
    "status": ("iu", "f"), "residual": ("f", "f"), "explained": ("f", "f"), "steps": ("iu", "f"),
    "points": ("iu", "f"), "limb_weight": ("f", "fl"), "passes_apart": ("f", "fl"), "beyond_limits": ("f", "fb"),
    "depth_inside": ("f", "fl"), "limb_covariance": ("f", "fl66"), "joint_covariance": ("f", "fj33"),
    "joint_confidence": ("f", "fj"), "up": ("f", "3"), "marker_residual": ("f", "m"), "limb_beside": ("f", "fl"),
    "limb_distance": ("f", "fl"), "limb_bare": ("f", "fl"), "limb_own": ("f", "fl"), "facing_odds": ("f", "f"),
    "T_fixed_steady": ("f", "f44"),
}  # fmt: skip
ALWAYS = tuple(f.name for f in (*fields(Tracks), *fields(Evidence)) if f.name in FORMS and f.default is MISSING)
EVIDENCE = FORMS.keys() & {f.name for f in fields(Evidence)}
FARTHEST = 1e30  # covariances are huge where nothing is known; not infinite
LATEST = 1 << 62  # nanoseconds, as config.limited.TIME
UNEVEN = 0.01  # of a unit quaternion's length: rounding
ROUNDED = 1e-5  # metres, by which lengths in files of bodies are rounded
MOST = 10_000  # people
TEXTS = ("run_key", "source", "fixed_frame", "body_json")


class TracksFileError(ValueError):
    """A file that is not a complete tracks file."""


def write_tracks_npz(tracks: Tracks, path: str | os.PathLike, run_key: str = "") -> None:
    """Writes `.tracks.npz`: arrays in metres and nanoseconds, in the tracks' fixed frame; no pickled objects.

    Keys are the names of the arrays of Tracks and Evidence, with their units, and: tracked; joint_names, limb_names,
    body_joint_names; body_json (name, the scale under its own name, segment_lengths), body_toml; fixed_frame, source,
    seconds, notes; marker_names beside marker_residual; person and people if there are several; run_key if one is given
    (see batch/resume.py); digest of all others.
    The file appears under its name only when complete. Raises OSError.
    """
    body = tracks.body
    summary = {"name": body.name, body.scale_name: float(body.scale), "segment_lengths": tracks.segment_lengths()}
    arrays: dict[str, Any] = {name: value for name, value in tracks.rows().items() if name in FORMS}
    arrays |= {
        "tracked": tracks.tracked,
        "joint_names": np.array(tracks.joint_names, np.str_),
        "body_joint_names": np.array(body.topology.joints, np.str_),
        "limb_names": np.array(body.topology.limbs, np.str_),
        "body_json": np.array(json.dumps(summary, allow_nan=False)),
        "body_toml": np.array(format_body(body)),
        "fixed_frame": np.array(tracks.fixed_frame),
        "source": np.array(tracks.source),
        "seconds": np.array(tracks.seconds, np.float64),
        "notes": np.array(tracks.notes, np.str_),
    }
    if tracks.up is not None:
        arrays["up"] = tracks.up
    if tracks.marker_residual is not None:
        arrays["marker_residual"] = np.array(list(tracks.marker_residual.values()), np.float32)
        arrays["marker_names"] = np.array(list(tracks.marker_residual), np.str_)
    if tracks.people > 1:
        arrays |= {"person": np.array(tracks.person), "people": np.array(tracks.people)}
    if run_key:
        arrays["run_key"] = np.array(run_key)
    with replacing(path) as partial, open(partial, "wb") as file:
        arrays[DIGEST] = np.array(digest(arrays))
        np.savez_compressed(file, **arrays)


def read_tracks_npz(path: str | os.PathLike) -> Tracks:
    """Reads a file of write_tracks_npz. Raises TracksFileError for any other, OSError if it does not exist."""
    with opened_file(path) as stream:
        data: dict[str, Any] = tracks_arrays(stream, path)
    missing = [name for name in (*ALWAYS, "body_toml", "fixed_frame", "source") if name not in data]
    if missing:
        raise TracksFileError(f"{path}: not a tracks file of this version: it has no {', '.join(missing)}")
    try:
        body = parse_body(str(data["body_toml"]), f"{path}, body_toml")
    except BodyFileError as error:
        raise TracksFileError(f"{path}: its body cannot be read: {error}") from error
    _check(data, body, path)
    off = data.pop("marker_residual", None)
    return Tracks(
        source=str(data["source"]),
        fixed_frame=str(data["fixed_frame"]),
        body=body,
        evidence=Evidence(**{name: data[name] for name in EVIDENCE & data.keys()}),
        **{name: data[name] for name in FORMS.keys() & data.keys() - EVIDENCE},
        marker_residual=None if off is None else dict(zip(data.get("marker_names", off).tolist(), off.tolist())),
        segments=_segments(data, body),
        seconds=float(data.get("seconds", 0.0)),
        notes=tuple(str(note) for note in data.get("notes", ())),
        person=int(data.get("person", 1)),
        people=int(data.get("people", 1)),
        names=_other_names(data, body),
    )


def _segments(data: Mapping[str, np.ndarray], body: Body) -> dict[str, float] | None:
    """The lengths in `body_json` that are not the body's own; None without any."""
    known = json.loads(str(data.get("body_json", "{}"))).get("segment_lengths")
    pairs, own = known.items() if isinstance(known, dict) else (), segment_lengths(body)
    found = {k: float(v) for k, v in pairs if k in own and isinstance(v, (int, float)) and 0 < v < FARTHEST}
    return {k: v for k, v in found.items() if abs(v - own[k]) > ROUNDED} or None


def _other_names(data: Mapping[str, np.ndarray], body: Body) -> tuple[str, ...]:
    names = tuple(map(str, data["joint_names"])) if "joint_names" in data else ()
    return () if names == body.topology.centres or len(names) != len(body.topology.centres) else names


def _check(data: Mapping[str, np.ndarray], body: Body, path: str | os.PathLike) -> None:
    """Raises TracksFileError for arrays that do not fit the body."""
    t = body.topology
    sizes = {"f": len(data["time_ns"]) if data["time_ns"].ndim else 0, "l": body.limb_count, "j": len(t.centres)}
    sizes |= {"b": len(t.joints), "m": data["marker_names"].size if "marker_names" in data else 0}
    for name, (kinds, shape) in FORMS.items():
        if name not in data:
            continue
        array = data[name]
        expected = tuple(sizes[n] if n.isalpha() else int(n) for n in shape)
        if array.shape != expected:
            raise TracksFileError(f"{path}: '{name}' has shape {array.shape} where its body needs {expected}")
        if array.dtype.kind not in kinds:
            raise TracksFileError(f"{path}: '{name}' holds {array.dtype}, which is the wrong type")
        if array.dtype.kind == "f" and (np.abs(array) > FARTHEST).any():
            raise TracksFileError(f"{path}: '{name}' has numbers beyond {FARTHEST:g}")
    stamps, norms = data["time_ns"], np.linalg.norm(data["rotation"], axis=-1)
    if not ((stamps >= 0) & (stamps < LATEST)).all() or (np.diff(stamps.astype(np.int64)) < 0).any():
        raise TracksFileError(f"{path}: 'time_ns' is not increasing, or has impossible times")
    if not (np.isnan(norms) | (np.abs(norms - 1) < UNEVEN)).all():
        raise TracksFileError(f"{path}: 'rotation' has quaternions that are no rotations")


def tracks_arrays(stream: Any, path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """The arrays of an open tracks file by name; checks those that do not depend on the body. Raises TracksFileError,
    which calls the file `path`."""
    try:
        data = arrays_in(stream)
        _check_plain(data)
    except NotArrays as problem:
        raise TracksFileError(f"{path}: not a tracks file: {problem}") from problem
    return data


def scale_of(data: Mapping[str, np.ndarray]) -> tuple[str, float]:
    """Name and value (metres) of a body's scale, from the arrays of a tracks file. Raises NotArrays."""
    try:
        body = json.loads(str(data["body_json"]))
        ((name, value),) = [item for item in body.items() if item[0] not in ("name", "segment_lengths")]
        if math.isfinite(value):
            return name, float(value)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError):
        pass
    raise NotArrays("'body_json' lacks the size of its body")


def _check_plain(data: Mapping[str, np.ndarray]) -> None:
    """Raises NotArrays for invalid values of the entries that are not arrays of a body."""
    for name in ("person", "people"):
        if name in data and not (data[name].dtype.kind in "iu" and data[name].shape == () and 1 <= data[name] <= MOST):
            raise NotArrays(f"'{name}' is not a number of people")
    if "seconds" in data:
        seconds = data["seconds"]
        if seconds.dtype.kind not in "iuf" or seconds.shape != () or not 0 <= seconds < math.inf:
            raise NotArrays("'seconds' is not a number of seconds")
    for name in (name for name in ("notes", "marker_names", "joint_names") if name in data):
        if data[name].ndim != 1 or data[name].dtype.kind != "U" and data[name].size:
            raise NotArrays(f"'{name}' is not a list of texts")
    for name in (name for name in TEXTS if name in data):
        if data[name].shape != () or data[name].dtype.kind != "U":
            raise NotArrays(f"'{name}' is no text")
    count = data["time_ns"].shape if "time_ns" in data else None
    for name, kinds in (("tracked", "b"), ("residual", "f")):
        if name in data and (data[name].shape != count or data[name].dtype.kind not in kinds):
            raise NotArrays(f"'{name}' does not have one entry for each frame")
    if "body_json" in data:
        scale_of(data)


def read_everybody(path: str | os.PathLike) -> list[Tracks]:
    """Tracks of the main person of a log, and those of its other people, from files beside it. Raises what
    read_tracks_npz raises."""
    main = read_tracks_npz(path)
    return [main, *(read_tracks_npz(person_place(os.fspath(path), k)) for k in range(2, main.people + 1))]
