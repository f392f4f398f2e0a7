"""Finds size, position and pose at the start: the best of trials with different headings. Host side."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import AnyArray, Poses, compose, on_host, rotate, unrotate
from voodoo_jax.geometry.rotations import limb_ends
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import RIGHT
from voodoo_jax.solve.scan import State, Step, at_rest, cost_of

FUNNEL = ((1, 6), (2, 4))  # after so many frames so many of the starts go on
STEPS = 15  # most steps of a frame until then
# radians per second: nobody turns about so fast. Measured: hips of 174 logs with truth turn at 10.4 in a dance, 9.5
# with a baseball bat, 8 serving at tennis, 4 and less in 167 (all but a thousandth of the frames)
FASTEST = 10.5
# metres per second: no joint moves so fast. Measured: joints of 196 logs with truth move at 11.2 (bowling), 11.0 in a
# spinning kick, 9.2 in a run
QUICKEST = 11.5


def place(
    body: Body, at: Float32[np.ndarray, "3"], up: Float32[np.ndarray, "3"], heading: Float32[np.ndarray, "*start 3"]
) -> Poses:
    """The rest pose standing on `at` (fixed frame, metres), its z axis along `up`, its x axis towards `heading`; for
    each of them (leading axes)."""
    z = up / np.linalg.norm(up)
    x = heading - (heading @ z)[..., None] * z
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    axes = np.stack([x, np.cross(z, x), np.broadcast_to(z, x.shape)], -1)
    q = Rotation.from_matrix(axes.reshape(-1, 3, 3)).as_quat(scalar_first=True).astype(np.float32)
    q = q.reshape(*x.shape[:-1], 1, 4)
    root = Poses(q, np.broadcast_to(np.asarray(at, np.float32), (*q.shape[:-1], 3)))
    return compose(root, on_host(body.rest))


def _level_direction(foot: np.ndarray, origin: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Horizontal unit vector from a place to a sensor; arbitrary if the sensor is right above."""
    towards = origin - foot
    towards = towards - (towards @ up) * up
    distance = np.linalg.norm(towards)
    side = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0, 1.0, 0])
    return towards / distance if distance > 0.1 else np.cross(up, side)


def standing_places(
    body: Body, frames: list[BodyObservation], floor: Plane, headings: int, front: np.ndarray | None = None
) -> list[Poses]:
    """Rest poses at the cloud's position in evenly spread headings, the first one towards `front` or facing the sensor
    that sees most."""
    cloud = np.concatenate([f.points for f in frames])
    up = floor.normal
    height = floor.height(cloud)
    # the upper half only: furniture that touches the body is low
    middle = np.median(cloud[height > 0.5 * np.percentile(height, 99)], 0)
    foot = floor.level(middle[None])[0]
    seen = np.bincount(np.concatenate([f.sensor for f in frames]), minlength=len(frames[0].origins))
    directions = [_level_direction(foot, origin, up) for origin in frames[0].origins]
    towards = directions[int(np.argmax(seen))]
    # the cloud is the near surface: the body's axis lies deeper by about its half thickness
    thickness = float(np.max(np.asarray(body.sizes)[:, 0]))
    several = np.count_nonzero(seen) > 1
    foot = foot - 0.8 * thickness * (np.average(directions, axis=0, weights=seen) if several else towards)
    angle = 2 * np.pi * np.arange(headings)[:, None] / headings
    first = towards if front is None else front
    direction = np.cos(angle) * first + np.sin(angle) * np.cross(up, first)
    poses = place(body, foot.astype(np.float32), up, direction.astype(np.float32))
    return [poses[k] for k in range(headings)]


class Trial(NamedTuple):
    """The results of the trials of one start."""

    state: State  # leading axis: trial
    cost: Float[np.ndarray, " trial"]  # mean of cost_of; lower is better


# states (leading axis: trial), numbers of frames, most steps of each (None: as many as ever)
# -> the states after them, and a Step for each (leading axes: trial and frame)
Tracked = Callable[[State, Int[np.ndarray, " frame"], int | None], tuple[State, Step]]


def run_trials(body: Body, starts: Poses, seen: Bool[np.ndarray, " frame"], tracked: Tracked) -> Trial:
    """Tracks the first frames from every start pose (leading axis: trial); those without points (not `seen`) do not
    count.

    Tracks the first frame from all of them, the others from fewer and fewer, the best of both facings (see FUNNEL); the
    cost of the rest is infinite.
    """
    many, frames = len(starts.translation), np.flatnonzero(seen)
    state, cost, alive = at_rest(on_host(starts)), np.zeros(many), np.arange(many)

    def go_on(chosen: Int[np.ndarray, " frame"], most: int | None) -> None:
        nonlocal state
        after, steps = tracked(jax.tree.map(lambda x: x[alive], state), chosen, most)
        cost[alive] += np.sum(cost_of(steps), 1)
        state = jax.tree.map(lambda x, new: _with(x, alive, new), state, after)

    done, (last, fewest) = 0, FUNNEL[-1]
    for until, kept in FUNNEL if len(seen) > last and many > fewest else ():
        # where a start is wrong, a frame takes all steps and is none the better
        go_on(frames[done:until], STEPS)
        alive = alive[_promising(body, np.asarray(state.poses.rotation)[alive], cost[alive], kept)]
        done = until
    go_on(frames[done:], None)
    whole = np.full(many, np.inf)
    whole[alive] = cost[alive]
    return Trial(state, whole / max(int(np.sum(seen)), 1))


def in_pieces(tracked: Callable[[State], tuple[State, Step]], states: State, most: int) -> tuple[State, Step]:
    """`tracked` of any number of states (leading axis), in batches."""
    pieces = [jax.tree.map(lambda x, at=at: x[at : at + most], states) for at in range(0, len(states.seen), most)]
    return jax.tree.map(lambda *parts: np.concatenate(parts), *map(tracked, pieces))


def _with(whole: np.ndarray, at: Int[np.ndarray, " some"], some: np.ndarray) -> np.ndarray:
    whole = whole.copy()
    whole[at] = some
    return whole


def _promising(
    body: Body, rotation: Float[np.ndarray, "trial limb 4"], cost: Float[np.ndarray, " trial"], kept: int
) -> Int[np.ndarray, " kept"]:
    """Indices of the trials to continue: those with the lowest cost, the first half of them evenly from both
    facings."""
    front = facing(on_host(body), rotation)
    turned = front @ front[np.argmin(cost)] < 0
    better = (cost[None] < cost[:, None]) & (turned[None] == turned[:, None])
    late = np.sum(better, 1) >= kept // 2
    return np.lexsort((cost, late))[:kept]


def facing(body: Body, rotation: Float[AnyArray, "*frame limb 4"]) -> Float[Any, "*frame 3"]:
    """Unit vectors in the facing direction of the body's first limb: the rest pose along x."""
    ahead = unrotate(body.rest.rotation[0], np.array([1.0, 0.0, 0.0], np.float32))
    return rotate(rotation[..., 0, :], ahead)


def turns_about(
    body: Body, rotation: Float[np.ndarray, "frame limb 4"], people: list[BodyObservation]
) -> Bool[np.ndarray, " step"]:
    """Whether the body faces the other way from a frame to the next, too fast for a turn; `people`: of the frames."""
    front = facing(on_host(body), rotation)
    cosine = np.sum(front[1:] * front[:-1], -1)
    seconds = np.diff([frame.time_ns for frame in people]) / 1e9
    return (cosine < 0) & (np.arccos(np.clip(cosine, -1.0, 1.0)) > FASTEST * seconds)


def too_fast(body: Body, segment: Segment, people: list[BodyObservation]) -> int:
    """In how many steps from a frame to the next a body turns about or moves faster than people do, even if its joints
    are a little off before and after; `people`: of the frames."""
    farthest = moved(body, segment).max(1, initial=0.0)
    seconds = np.diff([frame.time_ns for frame in people]) / 1e9
    return int(np.sum(turns_about(body, segment.rotation, people) | (farthest > QUICKEST * seconds + 2 * RIGHT)))


def moved(body: Body, segment: Segment) -> Float[np.ndarray, "step limb"]:
    """How far each limb that carries others, its farther end, moves from a frame to the next, metres. Hands and feet
    alone flicker if they have few points."""
    carries = np.array(sorted(set(body.topology.parents)), int)
    lengths = np.asarray(body.sizes)[carries, 4]
    ends = limb_ends(segment.rotation[:, carries], segment.translation[:, carries], lengths)
    return np.max(np.linalg.norm(np.diff(ends, axis=1), axis=-1), 0)
