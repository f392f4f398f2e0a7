"""A start hypothesis: the best of trials in all headings from one frame, and its cost. Host side."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from voodoo_jax.config.options import DetectSettings, StartSettings
from voodoo_jax.geometry.rigid import Poses, on_host
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.trackers.icp.body_size import rarity, sized
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.icp.trials import facing, standing_places
from voodoo_jax.trackers.shared.eye import poses_of
from voodoo_jax.trackers.shared.runner import FEW_POINTS

LIKELIER = 0.8  # another stance than standing, or than the previous one, must cost less than this share; by hand
OFF_FLOOR, HIDDEN = 0.04, 0.35  # metres: lowest points above the first: a jump; above the second: hidden feet
BADLY = 2.0  # times the unexplained cost of a sure start: above it a body fits badly; by hand
USUAL = 0.018  # metres of noise that every start is allowed; by hand

# where the learned eye sees a person: every n-th heading is tried, every n-th frame is used, and the weight of the
# logarithm of its odds against a start's facing in the logarithm of the cost: measured, experiments/eye
FEWER, EVERY, TURNED = 3, 3, 0.3


class StartHypothesis(NamedTuple):
    """A start hypothesis."""

    frame: int
    body: Body  # with its size
    poses: Poses
    cost: float  # see solve.scan.cost_of, body_size.rarity and turned
    noise: float = 0.0  # of the points of the trial, metres, at least USUAL

    def clear(self, sure: float) -> bool:
        """Whether it is certain, by its cost and the noise."""
        return self.unexplained <= sure and self.noise <= DetectSettings.noise

    @property
    def unexplained(self) -> float:
        """Cost above the cost of noise alone, square metres."""
        return self.cost - self.noise**2


def trial(run: Runner, at: int, body: Body, before: Poses | None = None, rest: Body | None = None) -> StartHypothesis:
    """The best of trials from frame `at`, see places_to_try, and of one in the poses `before`, moved to the points.

    **Arguments:** `rest` the body with another rest pose, from which trials begin.
    """
    frames = tried_on(run, at)
    places, factors = places_to_try(run, rest or body, frames)
    if before is not None:
        there, last = np.median(np.concatenate([f.points for f in frames]), 0), on_host(before)
        shift = (there - np.median(last.translation, 0)).astype(np.float32)
        places.append(Poses(last.rotation, last.translation + shift))
        factors.append(1.0)
    return best_from(run, at, body, places, np.array(factors))


def places_to_try(run: Runner, body: Body, frames: list[BodyObservation]) -> tuple[list[Poses], list[float]]:
    """Poses to try in the last of some frames: at rest in headings all round; with a person seen by the learned eye, in
    fewer headings, and also in its pose. And factors on their costs: the eye's pose is another stance than standing,
    see LIKELIER."""
    person = run.person_in(frames[-1])
    pose = None if person is None else poses_of(body, person)
    if person is None or pose is None:
        rest = standing_places(body, frames[::-1], run.scene.floor, run.settings.start.headings)
        return rest, [1.0] * len(rest)
    many = max(run.settings.start.headings // FEWER, 1)
    rest = standing_places(body, frames[::-1], run.scene.floor, many, person.front)
    return [*rest, pose], [1.0] * many + [1 / LIKELIER]


def turned(
    body: Body, rotation: Float[np.ndarray, "*pose limb 4"], front: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "*pose"]:
    """Factor on the cost of poses, at least 1, by the eye's odds against their facing; `front` see Seen, of all
    poses or of each."""
    return np.exp(TURNED * np.maximum(-np.sum(facing(on_host(body), rotation) * front, -1), 0.0))


def best_from(
    run: Runner, at: int, body: Body, places: list[Poses], factors: Float[np.ndarray, " place"] | float = 1.0
) -> StartHypothesis:
    """The best of trials from some poses in frame `at`, chosen by costs times `factors`, and by facing, see turned."""
    frames, some = tried_on(run, at), run.people[at : at + run.settings.start.size_frames : EVERY]
    tried, fronts = run.trials(body, frames, places), [p.front for f in some if (p := run.person_in(f)) is not None]
    poses = tried.state.poses
    costs = tried.cost * (turned(body, np.asarray(poses.rotation), np.mean(fronts, 0)) if fronts else 1.0)
    best = int(np.argmin(costs * factors))
    cost = float(np.exp(size_odds(run, body)) * costs[best])
    return StartHypothesis(at, body, jax.tree.map(lambda x: x[best], poses), cost, noise_of(frames))


def size_odds(run: Runner, body: Body) -> float:
    """Logarithm of the factor on a start's cost for its body's size; a known size is never unusual."""
    return 0.0 if body is run.body or run.settings.start.scale > 0 else rarity(body)


def sized_at(run: Runner, at: int, low: float = np.inf) -> Body:
    """The body in its known size, or else in the measured size, see measured_at."""
    return run.body if run.sized else measured_at(run, at, low)


def measured_at(run: Runner, at: int, low: float = np.inf) -> Body:
    """The body in the size measured from frame `at` on.

    **Arguments:** `low` height of the lowest points above the floor while standing, metres, to correct for jumps."""
    s: StartSettings = run.settings.start
    frames, up = run.frames(at, at + s.size_frames), run.scene.floor.normal
    lifts = (lowest(run, frame) - low for frame in frames)
    lowered = [replace(f, points=f.points - by * up) if OFF_FLOOR < by < HIDDEN else f for f, by in zip(frames, lifts)]
    return sized(run.body, lowered, run.scene.floor, s)


def lowest(run: Runner, frame: BodyObservation) -> float:
    """Height of the lowest points above the floor, metres."""
    return float(np.percentile(run.scene.floor.height(frame.points), 1)) if len(frame.points) else -np.inf


def tried_on(run: Runner, at: int) -> list[BodyObservation]:
    """The frames from `at` on that trials are compared over."""
    s: StartSettings = run.settings.start
    return soon([f for f in run.frames(at, at + 3 * s.frames) if len(f.points) >= FEW_POINTS], s)


def soon(frames: list[BodyObservation], s: StartSettings) -> list[BodyObservation]:
    """The first frames, over which trials are compared; over a longer time correct starts are lost, too."""
    return [f for k, f in enumerate(frames[: s.frames]) if k < 3 or f.time_ns - frames[0].time_ns <= s.seconds * 1e9]


def noise_of(frames: list[BodyObservation]) -> float:
    """Noise allowed for a start from these frames, metres."""
    # people are not cylinders: with a quieter sensor the points are no nearer to them
    return max(USUAL, float(np.median([f.noise for f in frames])))
