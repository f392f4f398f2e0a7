"""The chain of Knoop 2006 and 2007 with nothing of ours but the start: its loop on whole clouds, frame after frame."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.common import Log, load_truth
from voodoo_jax.config.options import Settings
from voodoo_jax.config.presets import preset
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.model.body_file import load_body
from voodoo_jax.records.observation import BodyObservation, whole
from voodoo_jax.records.tracks import Evidence, Tracks
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.solve.padding import pad_features, pad_frames
from voodoo_jax.solve.scan import State, Step, TrackOptions, at_rest, options_from, track_chunk
from voodoo_jax.trackers.base import LogInfo, Task
from voodoo_jax.trackers.of_points import track_person

CAPACITY = 2048  # points of a whole cloud, at most: denser ones are thinned at random
FOUND, NONE = 1024, 256  # points of somebody whom our finder found; and of nobody, whose weights are zero, padded
CHUNK, START = 64, 24  # frames of one run; frames that the start looks at
FEATURES = 8  # face and hands, padded


def bare(**solve: object) -> Settings:
    """The preset knoop2007 with some options of the solve changed."""
    settings = preset("knoop2007")
    return replace(settings, solve=replace(settings.solve, **solve))


@dataclass(frozen=True)
class Begun:
    """A recording with its start: size and first pose, and frames from there on."""

    log: Log
    clouds: list[BodyObservation]  # with all points of the scene
    body: Body  # in the person's size
    start: Poses
    first: int  # frame of the start
    source: Tracks  # what found the start


def begun(path: Path) -> Begun:
    """Size and first pose by the product's tracker with the papers' body, of the first frames; nothing else of it."""
    body = load_body("human10")
    reader = open_log(path)
    frames = list(reader.frames())
    scene, people = find_body(iter(frames), reader.up, body, Settings(), reader.up_is_given)
    found = track_person(Task(body, LogInfo(reader.path, reader.fixed_frame), Settings()), scene, people[:START])
    first = int(np.argmax(found.tracked))
    if not found.tracked[first]:
        raise SystemExit(f"{path}: nobody was found")
    truth = load_truth(path)
    log = Log(path.stem, reader.path, reader.fixed_frame, scene, people, truth.time_ns, truth.names, truth.joints)
    start = Poses(found.rotation[first], found.translation[first])
    return Begun(log, [whole(frame) for frame in frames], found.body, start, first, found)


@dataclass(frozen=True)
class Inputs:
    """What one kind of input is to the loop: chunks of padded frames."""

    points: list[Points]
    seconds: list[np.ndarray]
    valid: list[np.ndarray]
    features: list[Features]


def inputs(one: Begun, settings: Settings, kind: str, clouds: list[BodyObservation] | None = None) -> Inputs:
    """Frames from the start on with both kinds of measurement ("fusion"), with "3D data" or with "2D data" alone;
    `clouds` instead of the whole ones."""
    frames = (one.clouds if clouds is None else clouds)[one.first :]
    names, capacity = FeatureNames(one.body.topology, settings.features), CAPACITY if clouds is None else FOUND
    capacity = NONE if kind == "2D data" else capacity
    out, before = Inputs([], [], [], []), None
    for begin in range(0, len(frames), CHUNK):
        some = frames[begin : begin + CHUNK]
        chunk = pad_frames(some, capacity, CHUNK, before, len(some[0].origins))
        features = pad_features(some, CHUNK, FEATURES, names)
        assert features is not None
        points, nothing = chunk.points, jnp.zeros_like(chunk.points.weight)
        if kind == "2D data":
            points = eqx.tree_at(lambda p: p.weight, points, nothing)
        if kind == "3D data":
            features = eqx.tree_at(lambda f: f.weight, features, jnp.zeros_like(features.weight))
        out.points.append(points)
        out.seconds.append(chunk.seconds)
        out.valid.append(chunk.valid)
        out.features.append(features)
        before = some[-1].time_ns
    return out


@dataclass(frozen=True)
class Run:
    """What the loop gave: arrays of all frames from the start on."""

    rotation: np.ndarray
    translation: np.ndarray
    joints: np.ndarray
    steps: np.ndarray
    seconds: float  # of a processor, in all


def run(one: Begun, settings: Settings, given: Inputs, options: TrackOptions | None = None) -> Run:
    """The loop over all frames, each begun where the last one ended."""
    options = options or options_from(settings.solve, settings.track, settings.features)
    state: State = at_rest(one.start)
    body, found, began = one.body, list[Step](), time.process_time()
    for points, seconds, valid, features in zip(given.points, given.seconds, given.valid, given.features):
        state, step = track_chunk(body, options, state, points, seconds, valid, features)
        found.append(jax.block_until_ready(step))
    spent = time.process_time() - began
    count = sum(int(v.sum()) for v in given.valid)
    of = lambda get: np.concatenate([np.asarray(get(step)) for step in found])[:count]  # noqa: E731
    return Run(of(lambda s: s.poses.rotation), of(lambda s: s.poses.translation), of(lambda s: centres(body, s)),
               of(lambda s: s.steps), spent)  # fmt: skip


@eqx.filter_jit
def centres(body: Body, step: Step) -> jax.Array:
    """Joint centres [frame, centre, 3], metres."""
    return jax.vmap(lambda poses: joint_centres(body, poses))(step.poses)


def as_tracks(one: Begun, found: Run) -> Tracks:
    """The same as tracks of the whole recording: NaN before the start."""

    def filled(array: np.ndarray) -> np.ndarray:
        return np.concatenate([np.full((one.first, *array.shape[1:]), np.nan, array.dtype), array])

    count = len(one.clouds)
    evidence = Evidence.blank(count, one.body.limb_count)
    evidence.steps[one.first :] = found.steps
    evidence.limb_weight[:] = 1.0
    return replace(
        one.source, time_ns=np.array([f.time_ns for f in one.clouds], np.int64), rotation=filled(found.rotation),
        translation=filled(found.translation), joints=filled(found.joints), status=np.full(count, 2, np.int8),
        evidence=evidence, joint_confidence=None,
    )  # fmt: skip


def processor_seconds(contenders: dict[tuple, Callable[[], object]], turns: int) -> dict[tuple, float]:
    """Median seconds of a processor that each takes, in turns after one warm run: other jobs on the machine hit all
    alike."""
    spent: dict[tuple, list[float]] = {key: [] for key in contenders}
    for turn in range(turns + 1):
        for key, contender in contenders.items():
            began = time.process_time()
            contender()
            if turn:
                spent[key].append(time.process_time() - began)
    return {key: float(np.median(each)) for key, each in spent.items()}
