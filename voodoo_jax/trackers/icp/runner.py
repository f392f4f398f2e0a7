"""Passes one recording of depth through the compiled programs, and runs trials for starts. Host side."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np

from voodoo_jax.config.options import StartSettings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.attachments import directions, hung_on, pointing
from voodoo_jax.model.body import Body
from voodoo_jax.model.pose_library import Stance
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.solve.scan import State, Step
from voodoo_jax.trackers.icp.trials import Trial, in_pieces, run_trials
from voodoo_jax.trackers.shared.eye import Seen, seen
from voodoo_jax.trackers.shared.runner import FEW_POINTS, TRACKS, FrameRunner

LONG = 4.0  # times prior_interval: derived, over longer times a prediction does not count less (solve.scan)
# probability that a point is the person's. Measured: 0.3 to 0.9 are as good, 24 logs with a box beside somebody
OWN = 0.5
THING_FRAMES = 2  # times the frames of a start: a held thing has few points to tell where it points


class Runner(FrameRunner):
    """Tracks the points on one body, and runs trials for starts."""

    def __init__(self, *given: Any, **named: Any):
        super().__init__(*given, **named)
        self.known = False  # whether the body has had its size from the beginning
        self.facing = np.nan  # where nothing later is looked at: odds of the last look, see Segment.facing_odds
        self.seen: dict[int, Seen | None] = {}  # persons seen by the learned eye, by the time of the frame
        self.stances: dict[int, Stance] = {}  # that segments began in, by first frame, the last time they were tracked

    def can_start(self, at: int) -> bool:
        reach = self.people[at : at + 3 * self.settings.start.frames]
        return any(len(f.points) >= FEW_POINTS for f in reach)

    def person_in(self, frame: BodyObservation) -> Seen | None:
        """The person in a frame as seen by the learned eye; None for other bodies and on an unknown floor."""
        if self.body.scale_name != "stature" or self.scene.floor_open:
            return None
        if frame.time_ns not in self.seen:
            self.seen[frame.time_ns] = seen(frame, self.scene.floor)
        return self.seen[frame.time_ns]

    def frames(self, first: int, end: int) -> list[BodyObservation]:
        """In doubt without the points that the eye does not take for the person's."""
        frames = super().frames(first, end)
        return [self._own(frame) for frame in frames] if self.doubt else frames

    def _own(self, frame: BodyObservation) -> BodyObservation:
        """The frame with the points that the eye takes for the person's; with all where these are hardly any."""
        person = self.person_in(frame)
        own = frame if person is None else frame.only(person.own > OWN)
        return own if len(own.points) >= FEW_POINTS else frame

    def anew(self, people: list[BodyObservation] | None = None, known: Body | None = None) -> "Runner":
        """The same recording with other points on the body, or with a body whose size is known, before its first frame;
        segments may start in the same other stances again."""
        body, changes = self._given
        people = self.people if people is None else people
        other = Runner(known or body, self.options, people, self.scene, self.settings, changes, self.visit)
        other.sized = other.known = known is not None or self.known
        other.stances = self.stances
        if people is self.people:  # the eye would see the same
            other.seen = self.seen
        return other

    @property
    def offers(self) -> frozenset[str]:
        """Inputs that stages may need: "points", "one body" (without changes), "lag" (results may wait), and the body's
        joints."""
        one_body = {"one body"} if not self.settings.changes else set()
        lag = {"lag"} if self.settings.online and self.settings.online_lag > 0 else set()
        return frozenset({"points", *one_body, *lag, *self.body.topology.joints})

    def look_for(self, thing: str, limbs: list[int], at: int, state: State) -> None:
        """Finds the direction of a held object in the first frames from `at` on, by trials as at the start."""
        t = self.body.topology
        joint = t.children.index(t.limbs.index(thing))
        bodies = [pointing(self.body, joint, axis) for axis in directions(self.settings.start.directions)]
        starts = [hung_on(b, state.poses, limbs) for b in bodies]
        frames = min(THING_FRAMES * self.settings.start.frames, self.length)
        trial = self.trials(self.body, self.people[at : at + frames], starts)
        self.body = bodies[int(np.argmin(trial.cost))]

    def trials(self, body: Body, frames: list[BodyObservation], starts: list[Poses]) -> Trial:
        """Tracks some frames from every start pose, the last one first."""
        s: StartSettings = self.settings.start
        # backwards in time, so that the trials end where tracking begins
        chunk, features = self._padded(frames[::-1], None)
        if features is not None:
            # what may be face or hand fits any heading and blurs the choice between them
            point, weight = np.asarray(features.point), np.asarray(features.weight)
            weight = np.where(np.all(point == point[..., :1], -1), weight, np.float32(0))
            features = eqx.tree_at(lambda f: f.weight, features, jax.device_put(weight))
        # the interval by which the pull to the prediction is set: loose trials would bend to any heading
        seconds = np.minimum(np.abs(chunk.seconds), np.asarray(self.options.prior_interval))
        seen = np.any(np.asarray(chunk.points.weight)[: s.frames] > 0, 1)

        def tracked(states: State, chosen: np.ndarray, most: int | None) -> tuple[State, Step]:
            options, steps = self.options, self.options.icp.max_steps
            if most is not None:
                steps = jax.device_put(np.minimum(np.asarray(steps), np.int32(most)))
                options = eqx.tree_at(lambda o: o.icp.max_steps, options, steps)
            visit = partial(self._visited, body, options, (chunk.points, seconds, features), chosen, sure=False)
            return in_pieces(visit, states, max(1, min(TRACKS, self.length // max(len(chosen), 1))))

        return run_trials(body, jax.tree.map(lambda *leaves: np.stack(leaves), *starts), seen, tracked)
