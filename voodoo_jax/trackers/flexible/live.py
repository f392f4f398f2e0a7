"""The flexible tracker on live frames, with the results of a replay with `online` of the finished log. Host side."""

import time
from dataclasses import replace

import jax
import numpy as np

from voodoo_jax.compile.executable import seconds_of_waiting
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.detect.disk_buffer import Spill
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.base import LogInfo
from voodoo_jax.trackers.flexible.confidence import AROUND
from voodoo_jax.trackers.flexible.filters import Seen
from voodoo_jax.trackers.flexible.observed import Watching
from voodoo_jax.trackers.flexible.tracker import (
    NOBODY,
    Begun,
    begun,
    check_suited,
    chosen,
    descent,
    filtered,
    finished,
    nobody_of,
)


class LiveFlexible:
    """Tracks the main person in live frames with pictures of one camera or stereo pair.

    **Arguments:** `source` name of the log; `given` see Watching: then there may be frames without images.
    Raises Unsuitable, and SettingsError for settings that need later frames.
    """

    def __init__(self, body: Body, settings: Settings, source: str, given: bool = False):
        check_suited(body, settings)
        if not settings.online:
            raise SettingsError("live tracking needs settings.online")
        self._body, self.settings, self.seconds = body, settings, 0.0
        self._watching, self._kept = Watching(settings, source, given), Spill()
        self.watched = self._watching.watched  # the person in each frame
        self._people: list[BodyObservation] = []  # only the last one has points
        self._on: Begun | None = None
        self._rows: list[Seen] = []
        self._scene: Scene | None = None

    def prepare(self) -> None:
        """Does nothing: the size of the images, for which the program is compiled, is not known yet."""

    def add(self, frame: BodyObservation, scene: Scene) -> list[Tracks]:
        """Adds one frame; returns its tracks."""
        began, waited = time.perf_counter(), seconds_of_waiting()
        self._scene = scene
        if not self._watching.shows(len(self._people), frame.time_ns):
            return [nobody_of(self._body, np.array([frame.time_ns], np.int64), scene)]
        self._kept.append(frame)
        self._people[-1:] = [*(p.only(np.zeros(0, int)) for p in self._people[-1:]), frame]
        seen, row = self._watching.observed(self._people, scene), len(self._people) - 1
        if seen.others:
            raise SettingsError("live tracking by the flexible tracker looks through one camera or pair: read.topics")
        self._on = begun(self._body, seen, self.settings) if self._on is None else self._on._replace(seen=seen)
        if self._on is not None:
            self._on.look(row)
            states, every = filtered(
                self._on, self._on.states, seen, range(row, row + 1), self._on.key, self.settings.flexible
            )
            self._on = self._on._replace(states=states)
            self._rows.append(chosen(every, descent(every, True)))
        # arrays of the last frames alone: those of a long recording would be copied for each of its frames
        recent = self._rows[-AROUND:]
        seen = seen.since(row + 1 - max(1, len(recent)))
        out = nobody_of(self._body, seen.time_ns, scene)
        if self._on is not None:
            out = finished(self._on._replace(seen=seen, first=0), out, _concatenate(recent), self.settings)
        out = out.only(slice(seen.row[-1], seen.row[-1] + 1))
        self._watching.forget(row + 1)
        self.seconds += time.perf_counter() - began - (seconds_of_waiting() - waited)
        return [out]

    def end(self) -> list[Tracks]:
        """Ends the input; no frames are pending."""
        return []

    def whole(self, source: LogInfo) -> Tracks:
        """Tracks of all frames, as replay writes them."""
        people, scene = self._kept.frames(), self._scene
        assert scene is not None
        seen = self._watching.observed(people, scene)
        nobody = nobody_of(self._body, seen.time_ns, seen.scene, source.path, source.fixed_frame, source.notes())
        self._watching.close()
        if self._on is None:
            return replace(nobody, notes=(*nobody.notes, NOBODY))
        return finished(self._on._replace(seen=seen), nobody, _concatenate(self._rows), self.settings)


def _concatenate(rows: list[Seen]) -> Seen:
    return jax.tree.map(lambda *each: np.concatenate(each), *rows)
