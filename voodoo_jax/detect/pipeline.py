"""From frames to the scene and the body's points in every frame: the stages of detection in their order. Host side."""

from collections.abc import Iterable, Iterator
from itertools import chain, islice

import numpy as np
from jaxtyping import Float32

from voodoo_jax.config.options import Settings
from voodoo_jax.detect.body_likelihood import LOOSE, Build
from voodoo_jax.detect.camera_motion import steadied, steady_scene
from voodoo_jax.detect.disk_buffer import spilled
from voodoo_jax.detect.gravity import upright
from voodoo_jax.detect.planar_furniture import without_faces
from voodoo_jax.detect.raised_floor import on_its_floor
from voodoo_jax.detect.range_noise import weighed
from voodoo_jax.detect.segmentation import PersonFinder
from voodoo_jax.detect.target_selection import Chooser
from voodoo_jax.detect.touched_furniture import WINDOW, without_furniture, without_things
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.model.rest_shape import rest_box, rest_height
from voodoo_jax.records.observation import PersonFrame
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

SCENE_FRAMES, SCENE_EVERY = 15, 3  # floor and walls are looked for in every third of so many first frames


def find_person(
    frames: Iterable[Frame], up: Float32[np.ndarray, "3"], body: Body, settings: Settings
) -> tuple[Scene, list[PersonFrame]]:
    """Floor and walls, and the body's points of every frame. Of the frames, taken one by one, only these are kept."""
    stream: Iterator[Frame] = iter(frames)
    first = list(islice(stream, SCENE_FRAMES))
    scale = settings.start.scale
    # a body's scale need not be its height
    rested = scaled(body, scale) if scale > 0 else body
    low, high = rest_box(rested)
    # how large an animal or a machine is nobody knows, unless it is said
    loose = 0.0 if scale > 0 or body.scale_name == "stature" else LOOSE
    build = Build(rest_height(rested), float(np.max(high[:2] - low[:2])), loose)
    sure = bool(up[2] > 0.99)
    scene, planes = steady_scene(first, up, sure, SCENE_EVERY)
    some = first[:: SCENE_FRAMES // 2]
    other = upright(some, scene, up, sure, build, settings.detect)
    if other is not up:
        scene, planes = steady_scene(first, other, False, SCENE_EVERY)
    scene = on_its_floor(some, scene, build, settings.detect)
    all_frames = chain(first, stream)
    if settings.detect.steady:
        all_frames = steadied(all_frames, planes)
    ahead = settings.looks_ahead("detect")
    chooser = Chooser(scene, build, settings.detect, ahead)
    found = weighed(chooser(all_frames), settings.detect.noise)
    windows = iter(lambda: list(islice(found, WINDOW)), [])
    flat = body.scale_name != "stature"  # a machine may be
    told = chain.from_iterable(_told(window, chooser.finder, flat) for window in windows)
    people = spilled(told if ahead else found)
    return chooser.finder.scene, people  # the floor may have been found with the body


def _told(window: list[PersonFrame], finder: PersonFinder, flat: bool) -> list[PersonFrame]:
    """The frames without what all of them together tell to be furniture. `flat`: the body may have flat faces, too."""
    floor, link = finder.scene.floor, finder.settings.link
    left = without_furniture(without_things(window, floor, finder.apart(), link), floor.normal)
    return left if flat else without_faces(left, floor)
