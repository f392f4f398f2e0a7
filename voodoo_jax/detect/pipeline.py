"""From frames to the scene and the body's points in every frame: the stages of detection in their order. Host side.

A new stage needs a file, a line here, and a test file and a row of experiments/ablation of the same name.
"""

from collections.abc import Iterable, Iterator
from itertools import chain, islice

import numpy as np
from jaxtyping import Float32

from voodoo_jax.config.options import Settings
from voodoo_jax.detect.body_likelihood import LOOSE, Build
from voodoo_jax.detect.camera_motion import steady_scene
from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.detect.drop_garment import DropGarment
from voodoo_jax.detect.drop_motionless import DropMotionless
from voodoo_jax.detect.drop_planar_furniture import DropPlanarFurniture
from voodoo_jax.detect.drop_seen_apart import DropSeenApart
from voodoo_jax.detect.drop_wide_still import DropWideStill
from voodoo_jax.detect.find_gravity import FindGravity
from voodoo_jax.detect.raise_floor import RaiseFloor
from voodoo_jax.detect.stage import SCENE_EVERY, SCENE_FRAMES, Named, PointStage, SceneStage, Surroundings, Target
from voodoo_jax.detect.steady_sensors import SteadySensors
from voodoo_jax.detect.tracklets import Tracklets
from voodoo_jax.detect.weigh_by_noise import WeighByNoise
from voodoo_jax.model.body import Body, rest_box, rest_height, scaled
from voodoo_jax.records.observation import BodyObservation, whole
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene, Subject

# once floor and walls are found
SCENE: tuple[SceneStage, ...] = (FindGravity(), RaiseFloor(), SteadySensors())
# once the body is followed through the frames
POINTS: tuple[PointStage, ...] = (
    WeighByNoise(), DropGarment(), DropMotionless(), DropSeenApart(), DropPlanarFurniture(), DropWideStill(),
)  # fmt: skip


def stages() -> tuple[Named, ...]:
    """Names of all stages of detection that can be skipped."""
    return (*SCENE, *POINTS)


def find_body(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings, up_is_given: bool = False
) -> tuple[Scene, list[BodyObservation]]:
    """Floor and walls, and the points of the main person (or body) of every frame. Frames are read one by one, and only
    these points are kept.

    **Arguments:** `up_is_given`: the user has stated the upward direction, so it is not estimated.
    """
    tracklets, seen = watched(frames, up, body, settings, up_is_given)
    kept = spilled(seen)
    return tracklets.finder.scene, kept  # the floor may have been found with the body


def watched(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings, up_is_given: bool = False
) -> tuple[Tracklets, Iterator[BodyObservation]]:
    """The points of the main person (or body), frame by frame as they come, and the tracklets, which hold floor and
    walls; as `find_body`. The first few frames are read at once."""
    found = surroundings(frames, up, body, settings, up_is_given)
    several = settings.detect.people != 1  # what others have is not the main one's, as in `find_people`
    ahead = settings.looks_ahead("detect")
    tracklets = Tracklets(found.scene, found.build, settings.detect, ahead, several, keeps=False)
    return tracklets, iter(_corrected(tracklets(found.frames), tracklets, body, settings))


def find_people(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings, up_is_given: bool = False
) -> list[Subject]:
    """All people in view, those seen longest first, at most `settings.detect.people`; at least one subject, without
    points if there is no person. Frames are read one by one, and only the points on people are kept."""
    if settings.detect.people == 1:
        return [Subject(1, *find_body(frames, up, body, settings, up_is_given))]
    found = surroundings(frames, up, body, settings, up_is_given)
    tracklets = Tracklets(found.scene, found.build, settings.detect, settings.looks_ahead("detect"), several=True)
    seen = spilled(tracklets(found.frames))

    def subject(number: int, target: Target, frames: Iterable[BodyObservation]) -> Subject:
        kept = spilled(_corrected(frames, target, body, settings))
        return Subject(number, target.finder.scene, kept)  # the floor may have been found with the body

    everybody = tracklets.people(seen)[: settings.detect.people or None]
    return [subject(k, one, one.frames) for k, one in enumerate(everybody, 1)] or [subject(1, tracklets, seen)]


def only_named(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings, up_is_given: bool = False
) -> list[Subject]:
    """As `find_people`, for recordings without depth: there are no points to segment."""
    found = surroundings(frames, up, body, settings, up_is_given)
    return [Subject(1, found.scene, [whole(frame) for frame in found.frames])]


def surroundings(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings, up_is_given: bool = False
) -> Surroundings:
    """The state of a recording before the search for the body; reads the first frames."""
    stream: Iterator[Frame] = iter(frames)
    first, sure = list(islice(stream, SCENE_FRAMES)), bool(up[2] > 0.99)
    scene, planes = steady_scene(first, up, sure, SCENE_EVERY)
    build = build_of(body, settings.start.scale)
    found = Surroundings(chain(first, stream), first, up, sure, scene, planes, build, settings.detect)
    for stage in SCENE:
        if _is_active(stage, body, settings) and not (up_is_given and isinstance(stage, FindGravity)):
            found = stage(found)
    return found


def _corrected(
    frames: Iterable[BodyObservation], target: Target, body: Body, settings: Settings
) -> Iterable[BodyObservation]:
    """The frames after the stages that correct the points on the body."""
    for stage in POINTS:
        if _is_active(stage, body, settings):
            frames = stage(frames, target)
    return frames


def _is_active(stage: Named, body: Body, settings: Settings) -> bool:
    skipped = settings.skips("detect", stage.name, stage.looks_ahead)
    return not skipped and stage.needs <= ({"person"} if body.scale_name == "stature" else set())


def build_of(body: Body, scale: float) -> Build:
    """Known size of the body; `scale` 0: to be estimated."""
    # a body's scale need not be its height
    rested = scaled(body, scale) if scale > 0 else body
    low, high = rest_box(rested)
    # how large an animal or a machine is nobody knows, unless it is said
    loose = 0.0 if scale > 0 or body.scale_name == "stature" else LOOSE
    return Build(rest_height(rested), float(np.max(high[:2] - low[:2])), loose)
