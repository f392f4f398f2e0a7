"""Both trackers on live frames, with the same results as a replay with `online` of the finished log. Host side."""

from collections import deque
from dataclasses import replace

import numpy as np

from voodoo_jax.config.options import Settings
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene, Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import LogInfo
from voodoo_jax.trackers.both.entry import together
from voodoo_jax.trackers.both.merge import compared_frames
from voodoo_jax.trackers.flexible.live import LiveFlexible
from voodoo_jax.trackers.icp.live import LiveTracker, joined_tracks


class LiveBoth:
    """Tracks the main person with both trackers and merges their poses frame by frame.

    **Arguments:** `first`, `scene` and `features` as for LiveTracker; `source` name of the log. Raises Unsuitable, and
    SettingsError for settings that need later frames.
    """

    # 6 parameters: those of both trackers
    def __init__(
        self, body: Body, settings: Settings, source: str, first: list[BodyObservation], scene: Scene, features: bool
    ):  # fmt: skip
        self._icp = LiveTracker(body, settings, first, scene, features)
        self._flexible = LiveFlexible(body, settings, source, given=True)
        self._scene, self.watched, self._settings = scene, self._flexible.watched, settings
        self._one = replace(settings, track=replace(settings.track, chunk=1))  # for merging one frame
        self._waiting: deque[tuple[BodyObservation, Tracks]] = deque()  # for the ICP tracker's result
        self._recent: list[tuple[Tracks, Tracks]] = []  # tracks over which both are compared

    def prepare(self) -> None:
        """Compiles or loads the programs of the ICP tracker."""
        self._icp.prepare()

    def add(self, frame: BodyObservation, scene: Scene) -> list[Tracks]:
        """Adds one frame; returns tracks of one frame each, for the frames that are final now, in order."""
        self._scene = scene
        self._waiting.append((frame, self._flexible.add(frame, scene)[0]))
        return [self._merge(icp) for icp in self._icp.add(frame, scene)]

    def end(self) -> list[Tracks]:
        """Ends the input; returns the frames that waited for more."""
        return [self._merge(icp) for icp in self._icp.end()]

    def _merge(self, icp: Tracks) -> Tracks:
        frame, flexible = self._waiting.popleft()
        if flexible.joint_confidence is None:
            flexible = replace(flexible, joint_confidence=np.full(flexible.joints.shape[:2], np.nan, np.float32))
        self._recent.append((icp, flexible))
        one, other = (
            joined_tracks([replace(t, body=last.body) for t in parts])
            for parts, last in zip(zip(*self._recent), (icp, flexible))
        )
        self._recent = self._recent[1 - compared_frames(one.time_ns) :]
        return together(one, other, Subject(1, self._scene, [frame]), self._one)

    def whole(self, source: LogInfo) -> Tracks:
        """Tracks of all frames, as replay writes them."""
        icp, flexible = self._icp.whole(source), self._flexible.whole(replace(source, notes=tuple))
        return together(icp, flexible, Subject(1, self._scene, self._icp.people), self._settings)
