"""Selects the frames of a fit from tracked recordings, with some of a frame's points to solve on and others to fit to.

Host side. The selection depends on the recording alone, so it is the same on every run.
"""

import os
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Float64, Int, Int64
from scipy.spatial.transform import Rotation

from voodoo_jax.config.options import FeatureSettings
from voodoo_jax.detect.camera_motion import as_measured
from voodoo_jax.fitting.objective import FitFrames
from voodoo_jax.geometry.arrays_file import arrays_in
from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.model.body import Topology
from voodoo_jax.model.marker_sets import V1_NAMES
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.stretches import spread
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.solve.padding import FEATURE_BUCKETS, bucket, pad_features, pad_frames
from voodoo_jax.storage.troubles import opened_file

RUNS, EVERY = 16, 3  # a log is cut into this many runs of time; every third is fitted to, the others judge
FEWEST = 8  # least number of frames to fit to
HALF_FRAME_NS = 17_000_000  # a truth at a larger time difference belongs to another frame
ALIKE = 0.2  # radians: views of a limb whose angles differ by less count as the same
WELL = 1.5  # times the median residual: frames above are not well tracked


class Truth(NamedTuple):
    """Known joint centres over time."""

    time_ns: Int64[np.ndarray, " time"]
    names: tuple[str, ...]
    joints: Float64[np.ndarray, "time joint 3"]  # metres, in the fixed frame of the log; NaN: unknown


class TruthError(ValueError):
    """The truth file cannot be used."""


def read_truth(path: str | os.PathLike[str]) -> Truth:
    """Reads joint centres from an .npz with `time_ns`, `joints` [time, joint, 3] and `joint_names` (or `names`).

    Raises TruthError.
    """
    try:
        with opened_file(path) as stream:
            file = arrays_in(stream)
        key = "joint_names" if "joint_names" in file else "names"
        missing = [k for k in ("time_ns", "joints", key) if k not in file]
        if missing:
            raise TruthError(f"{path}: no array '{missing[0]}'; a truth has time_ns, joints and joint_names")
        names = tuple(V1_NAMES.get(str(n), str(n)) for n in file[key])
        stamps, joints = file["time_ns"].astype(np.int64), file["joints"].astype(np.float64)
    except (OSError, ValueError, TypeError) as problem:
        if isinstance(problem, TruthError):
            raise
        raise TruthError(f"{path}: cannot be read as a truth: {problem}") from problem
    if joints.shape != (len(stamps), len(names), 3):
        raise TruthError(f"{path}: joints are {joints.shape}, but there are {len(stamps)} times and {len(names)} names")
    return Truth(stamps, names, joints)


def runs(count: int) -> Int[np.ndarray, " frame"]:
    """The run of time of each of a log's frames."""
    return np.arange(count) * RUNS // max(count, 1)


def held_back(count: int) -> Bool[np.ndarray, " frame"]:
    """Which of a log's frames are held back from the fit: whole runs of time, since neighbouring frames are alike."""
    return runs(count) % EVERY > 0


def chosen_frames(tracks: Tracks, points: Int[np.ndarray, " frame"], count: int) -> np.ndarray:
    """Up to `count` well tracked frames that are not held back, evenly spread. Raises ValueError with too few frames.

    **Arguments:** `points` number of points of each frame.
    """
    residual = np.where(tracks.tracked, tracks.evidence.residual, np.inf)
    seen = (points >= 60) & ~held_back(len(points))
    good = (
        np.flatnonzero((residual <= WELL * np.median(residual[tracks.tracked])) & seen) if tracks.tracked.any() else []
    )
    if len(good) < FEWEST:
        raise ValueError(
            f"{tracks.source}: only {len(good)} frames are tracked well enough to fit to, {FEWEST} are needed; "
            "look at the log with voodoo-jax replay --picture"
        )
    return np.asarray(good)[spread(len(good), count)]


def feature_names(people: list[BodyObservation], topology: Topology, settings: FeatureSettings) -> tuple[str, ...]:
    """Names of the features in some frames for which the body has a point."""
    names = FeatureNames(topology, settings)
    found = sorted({name for f in people for name in (*f.rays.names, *f.pairs.names)})
    return tuple(name for name in found if names.look_up(name))


# 10 parameters: the recording, and how its frames are used
def fit_frames(
    tracks: Tracks,
    people: list[BodyObservation],
    at: Int[np.ndarray, " chosen"],
    features: FeatureSettings,
    names: tuple[str, ...],
    count: int,
    points: int,
    truth: Truth | None = None,
    log: int = 0,
    markers: bool = False,
) -> FitFrames:
    """Frames of one recording, padded to `count`, each with up to `points` points to solve on and as many to fit to.

    **Arguments:** `at` which frames (see chosen_frames); `names` of the measurement weights that may be free; `log`
    number of the recording; `markers` named points only judge; otherwise half of a frame's features judge.
    """
    solve, judge, people = [], [], [as_measured(frame) for frame in people]
    for number, frame in enumerate(people[i] for i in at):
        order = np.random.default_rng(frame.time_ns & 0xFFFFFFFFFFFF).permutation(len(frame.points))[: 2 * points]
        parts = []
        for k in (0, 1):
            mask = np.zeros(len(frame.points), bool)
            mask[order[k::2]] = True
            rays, pairs = ((np.arange(len(each.names)) + number) % 2 == k for each in (frame.rays, frame.pairs))
            pairs = np.full(len(pairs), k == 1) if markers else pairs
            parts.append(replace(frame.only(mask), rays=frame.rays.only(rays), pairs=frame.pairs.only(pairs)))
        solve.append(parts[0])
        judge.append(parts[1])
    sensors, capacity = len(people[0].origins), bucket(points)
    table = FeatureNames(tracks.body.topology, features)
    most = max((len(f.rays.names) + len(f.pairs.names) for f in people), default=0)
    room = bucket(most, FEATURE_BUCKETS) if names else 0
    choices = table.choices({name for f in people for name in (*f.rays.names, *f.pairs.names)})
    numbered = FeatureNames(tracks.body.topology, features)
    for row, name in enumerate(names, 1):
        numbered.weights[numbered.plain(name)] = float(row)
    alike = [replace(f, rays=replace(f.rays, weights=None), pairs=replace(f.pairs, weights=None)) for f in solve]
    rows = pad_features(alike, count, room, numbered, choices)
    known = None
    if truth is not None:
        known = truth_at(truth, [people[i].time_ns for i in at], tracks.body.topology, count)
        known[: len(at)] -= placed_by(tracks, at)
    origins = np.stack([people[i].origins.mean(0) for i in at])
    padded = lambda x: jnp.concatenate([x, jnp.repeat(x[-1:], count - len(x), 0)])  # noqa: E731  by the last frame
    poses = Poses(padded(jnp.asarray(tracks.rotation[at])), padded(jnp.asarray(tracks.translation[at])))
    return FitFrames(
        points=pad_frames(solve, capacity, count, None, sensors).points,
        held=pad_frames(judge, capacity, count, None, sensors).points,
        features=pad_features(solve, count, room, table, choices),
        held_features=pad_features(judge, count, room, table, choices),
        feature_name=None if rows is None else jnp.maximum(rows.weight.astype(jnp.int32) - 1, 0),
        poses=poses,
        truth=None if known is None else jnp.asarray(np.nan_to_num(known), jnp.float32),
        known=None if known is None else jnp.asarray(np.isfinite(known).all(-1)),
        log=jnp.full(count, log, jnp.int32),
        weight=jnp.asarray(np.arange(count) < len(at), jnp.float32),
        news=jnp.asarray(news(tracks, origins, at, count), jnp.float32),
    )


def placed_by(tracks: Tracks, at: Int[np.ndarray, " chosen"]) -> Float[np.ndarray, "chosen centre 3"]:
    """Offsets by which stages after the pose moved the joints of some frames from the body's own centres, metres.

    A pose fitted to known joints must keep its centres at these offsets from them, since the stages move them again.
    """
    limbs = np.array(tracks.body.topology.centre_limbs, int)
    poses = Poses(tracks.rotation[at][:, limbs], tracks.translation[at][:, limbs])
    return tracks.joints[at] - apply(poses, np.asarray(tracks.body.centres))


def news(
    tracks: Tracks, origins: Float[np.ndarray, "chosen 3"], at: Int[np.ndarray, " chosen"], count: int
) -> Float64[np.ndarray, "frame limb"]:
    """New information of each chosen frame about each limb, 0..1; zero for padding.

    A person differs from cylinders in the same way in all frames with the same view of a limb, so these frames share
    one vote. Views are the same if the angles of the limb to its neighbours and to the line of sight are the same.

    **Arguments:** `origins` position of the sensor in each chosen frame, metres.
    """
    t = tracks.body.topology
    axes = Rotation.from_quat(tracks.rotation[at].reshape(-1, 4), scalar_first=True).apply([0.0, 0.0, 1.0])
    axes = axes.reshape(len(at), -1, 3)
    sight = origins[:, None] - tracks.translation[at]
    sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
    between = lambda a, b: np.arccos(np.clip(np.sum(a * b, -1), -1, 1))  # noqa: E731
    out = np.zeros((count, len(t.limbs)))
    for limb in range(len(t.limbs)):
        near = [p if c == limb else c for p, c in zip(t.parents, t.children) if limb in (p, c)]
        angles = np.stack([between(axes[:, limb], v) for v in (sight[:, limb], *(axes[:, n] for n in near))], -1)
        apart = np.sum((angles[:, None] - angles[None]) ** 2, -1)
        out[: len(at), limb] = 1 / np.exp(-apart / (2 * ALIKE**2)).sum(1)
    return out


def truth_at(truth: Truth, stamps: list[int], topology: Topology, count: int) -> np.ndarray:
    """Joint centres of the body at some times [count, centre, 3], metres; NaN where nothing is known."""
    out = np.full((count, len(topology.centres), 3), np.nan)
    for i, stamp in enumerate(stamps):
        k = int(np.abs(truth.time_ns - stamp).argmin())
        if abs(int(truth.time_ns[k]) - stamp) < HALF_FRAME_NS:
            for j, name in enumerate(truth.names):
                if name in topology.centres:
                    out[i, topology.centres.index(name)] = truth.joints[k, j]
    if not np.isfinite(out).any():
        raise TruthError("the truth has no joint of this body at the times of the log: is it the truth of this log?")
    return out
