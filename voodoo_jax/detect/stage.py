"""Inputs and outputs of the stages of detection.

The name of a stage is its file, its switch (`detect.skip`), its test file and its row in experiments/ablation.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import Build, mostly_lie
from voodoo_jax.detect.camera_motion import Planes, steady_scene
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.detect.stillness import Stillness
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene

SCENE_FRAMES, SCENE_EVERY = 15, 3  # number of first frames in which floor and walls are searched, and step; by hand
WINDOW = 1800  # frames that a stage handles at once; by hand


@dataclass(frozen=True)
class Surroundings:
    """The state of a recording before the search for the body."""

    frames: Iterable[Frame]  # all, one by one
    first: list[Frame]  # of them
    up: Float32[np.ndarray, "3"]  # unit vector, fixed frame
    up_is_sure: bool
    scene: Scene
    planes: Planes  # what stays where it is while sensors move
    build: Build  # of the body
    settings: DetectSettings

    @property
    def some(self) -> list[Frame]:
        """A few of the first frames, evenly spread."""
        return self.first[:: SCENE_FRAMES // 2]

    def with_planes(self) -> "Surroundings":
        """The same with floor and walls found again."""
        scene, planes = steady_scene(self.first, self.up, self.up_is_sure, SCENE_EVERY)
        return replace(self, scene=scene, planes=planes)


@runtime_checkable
class Target(Protocol):
    """The body that is followed, in its present state."""

    @property
    def finder(self) -> BodySegmenter: ...
    @property
    def settings(self) -> DetectSettings: ...
    @property
    def stillness(self) -> Stillness: ...


@runtime_checkable
class Named(Protocol):
    """Attributes of every stage."""

    name: ClassVar[str]
    looks_ahead: ClassVar[bool]  # uses later frames: left out with Settings.online
    # else it is passed over. Of detection: "person" (animals and machines are none); of tracking: of Runner.offers
    needs: ClassVar[frozenset[str]]


@runtime_checkable
class SceneStage(Named, Protocol):
    """A correction of the scene."""

    def __call__(self, found: Surroundings) -> Surroundings: ...


@runtime_checkable
class PointStage(Named, Protocol):
    """A correction of the points on the body, frame by frame."""

    def __call__(self, frames: Iterable[BodyObservation], target: Target) -> Iterator[BodyObservation]: ...


def shows_lying_person(window: list[BodyObservation], target: Target) -> bool:
    """Whether the body was found as a lying person, and lies in most of these frames."""
    return target.finder.lies and mostly_lie(window, target.finder.scene.floor)


class WindowStage:
    """A correction of the points on a person by windows of successive frames. Frames that were yielded are not kept, so
    that each stage keeps one window in memory."""

    looks_ahead: ClassVar[bool] = True
    needs: ClassVar[frozenset[str]] = frozenset({"person"})

    def change(self, window: list[BodyObservation], target: Target) -> list[BodyObservation]:
        """The corrected frames of a window; the same list if nothing changes."""
        raise NotImplementedError

    def __call__(self, frames: Iterable[BodyObservation], target: Target) -> Iterator[BodyObservation]:
        stream = iter(frames)
        while window := list(islice(stream, WINDOW)):
            changed = self.change(window, target)
            if changed is not window:
                window.clear()
            changed.reverse()
            while changed:
                yield changed.pop()
