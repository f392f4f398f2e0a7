"""The objective of a fit: distances of held-back measurements from the body, or of joints from a known truth.

Every frame's pose is solved on one part of its points; the other, held-back part is the objective. So a body cannot win
by poses that follow the noise. Since both parts have nearly the same minimum, pose and sizes are fitted together
(variable projection, Golub and Pereyra 1973).
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.compile.xla_options import one_by_one
from voodoo_jax.fitting.parameters import Changes, Maps, changed, changed_options, changes_at
from voodoo_jax.geometry.rigid import Poses, rotate
from voodoo_jax.geometry.robust import geman_mcclure_root
from voodoo_jax.kernels.correspondences import Points, closest_limbs, match_assigned
from voodoo_jax.kernels.landmarks import Features, named_points
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.solve.implicit import Rest, carried, resting
from voodoo_jax.solve.pulls import IcpOptions, Problem

# Standard deviations of one measurement. Points: a person's surface is 2 cm from cylinders, and the points of a patch
# of skin share this error; so a limb counts as PER_LIMB measurements per frame, whatever its number of points.
POINT_SD, PER_LIMB = 0.02, 1.0  # metres; independent measurements of each limb in each frame
FEW = 10.0  # number of points at which a limb counts half
RAY_SD = 0.03  # metres: a detected point from the body's, across the line of sight
JOINT_SD = 0.03  # metres: tracked joints from the truth
JOINT_NEAR = 0.01  # metres, by hand: below, a joint counts by its squared distance, above by its distance
# with more steps poses adapt to a wrong size instead: of a trunk 15 % too thin only 7 % of the error is found
NEWTON = 3  # Newton steps after the ICP steps
BATCH = 8  # frames that are solved at once
SETTLED = 0.002  # metres: frames farther from rest than this (see Solution.off) do not count
ROBUST = 0.06  # metres at which residuals lose weight


class FitFrames(eqx.Module):
    """Frames to fit to, padded; leading axis: frame."""

    points: Points  # for solving the poses
    held: Points  # held back, for judging them
    features: Features | None
    held_features: Features | None
    feature_name: Int[Array, "frame feature"] | None  # row among the measurement weights
    poses: Poses  # [frame limb] as tracked: start and prediction
    truth: Float[Array, "frame centre 3"] | None  # joint centres in the frame of the points, metres
    known: Bool[Array, "frame centre"] | None  # True: the truth is known
    log: Int[Array, " frame"]  # which recording
    weight: Float[Array, " frame"]  # 0: padding
    news: Float[Array, "frame limb"]  # new information of the frame about each limb, 0..1; see frames.news


Objective = Literal["held", "truth"]


def frame_problem(body: Body, options: IcpOptions, frame: FitFrames, by: Changes) -> Problem:
    """The problem that a frame's pose solves."""
    return Problem.build(body, frame.points, frame.poses, options, changed_features(frame, by))


def changed_features(frame: FitFrames, by: Changes) -> Features | None:
    """Features of one frame or of many, with changed weights."""
    features = frame.features
    if features is None or frame.feature_name is None or not by.features.shape[0]:
        return features
    return eqx.tree_at(lambda f: f.weight, features, features.weight * jnp.exp(by.features[frame.feature_name]))


def frame_residuals(
    body: Body, options: IcpOptions, frame: FitFrames, poses: Poses, objective: Objective
) -> Float[Array, " residual"]:
    """Residuals of one frame (no leading axes) in standard deviations.

    **Arguments:** `objective` "held": measurements held back; "truth": joint centres.
    """
    if objective == "truth":
        assert frame.truth is not None and frame.known is not None
        gap = jnp.where(frame.known[:, None], joint_centres(body, poses) - frame.truth, 0.0)
        return (as_distances(gap) / JOINT_SD).reshape(-1)
    parts = [_point_residuals(body, options, frame, poses)]
    if frame.held_features is not None:
        parts.append(_ray_residuals(body, frame.held_features, poses))
    return jnp.concatenate(parts)


def _apply_robust_loss(gap: Float[Array, "n 3"], scale: float) -> Float[Array, "n 3"]:
    """Vectors whose squares are Geman and McClure's loss of the given vectors."""
    return gap * jnp.sqrt(geman_mcclure_root(jnp.sum(gap * gap, -1, keepdims=True), scale))


def as_distances(gap: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Vectors whose squares grow like the lengths of the given vectors beyond JOINT_NEAR (pseudo-Huber).

    Tracks are judged by the mean distance of joints; a sum of squares is dominated by limbs lost for some frames.
    """
    over = jnp.sum(gap * gap, -1, keepdims=True) / JOINT_NEAR**2
    return gap * jnp.sqrt(2 / (1 + jnp.sqrt(1 + over)))


def _point_residuals(body: Body, options: IcpOptions, frame: FitFrames, poses: Poses) -> Float[Array, " residual"]:
    """Residuals of held-back points from the visible side of the limbs; vectors, so that no root is taken."""
    matching = eqx.tree_at(lambda o: o.robust_scale, options.match, jnp.full_like(options.match.robust_scale, jnp.inf))
    at, sizes = jax.lax.stop_gradient((poses, body.sizes))
    # the nearest limb under any rule: where a point changes limbs, both are at the same distance
    limbs = closest_limbs(sizes, at, frame.held, options.match, body.present)
    found = match_assigned(body.sizes, poses, frame.held, limbs, matching)
    # points beyond an end count too: without them a limb that is too short has no error, and a longer one always gains
    there = found.weight[0] > 0
    gap = jnp.stack([jnp.where(there, p - c, 0.0) for p, c in zip(found.data, found.model)], -1)
    # a limb counts as PER_LIMB independent measurements for any number of points, but less with few points
    count = jax.ops.segment_sum(there.astype(gap.dtype), limbs, body.limb_count + 1)
    share = PER_LIMB * jnp.append(frame.news, 0.0) / (count + FEW)
    return (_apply_robust_loss(gap, ROBUST) * jnp.sqrt(share)[limbs][:, None] / POINT_SD).reshape(-1)


def _ray_residuals(body: Body, features: Features, poses: Poses) -> Float[Array, " residual"]:
    """Residuals of held-back features, across their lines of sight or from their positions."""
    limbs, places = named_points(body)
    point = features.point[:, 0]
    world = rotate(poses.rotation[limbs[point]], places[point]) + poses.translation[limbs[point]]
    d = features.direction
    gap = features.origin + d * jnp.sum(d * (world - features.origin), -1, keepdims=True) - world
    # features that may be face or hand do not judge
    sure = jnp.all(features.point == features.point[:, :1], -1) & (features.weight > 0)
    gap = jnp.where(sure[:, None], gap, 0.0)
    return (_apply_robust_loss(gap, 3 * ROBUST) / RAY_SD).reshape(-1)


class Placed(NamedTuple):
    """Many frames at rest; leading axis: frame."""

    rest: Rest
    cost: Float[Array, " frame"]  # half the squared residuals
    converged: Bool[Array, " frame"]  # other frames do not count


class Normals(NamedTuple):
    """Gauss-Newton sums of many frames; leading axis: frame. Zero where the frame is not at rest."""

    slope: Float[Array, "frame free"]
    curve: Float[Array, "frame free free"]


# 7 parameters, traced and static ones
def placed(
    body: Body, options: IcpOptions, frames: FitFrames, starts: Poses, x: Float[Array, " free"], maps: Maps,
    objective: Objective,
) -> Placed:  # fmt: skip
    """Solves all frames at x from `starts` [frame limb]; returns the results and their costs."""
    by = changes_at(maps, x)
    new, changed_to = changed(body, by), changed_options(options, by)

    def one(inputs):
        frame, start = inputs
        found = resting(start, frame_problem(new, changed_to, frame, by), newton=NEWTON)
        r = frame_residuals(new, changed_to, frame, found.poses, objective)
        good = (found.off < SETTLED) & (frame.weight > 0) & jnp.all(jnp.isfinite(r))
        return Placed(found, jnp.where(good, jnp.sum(r * r) / 2, 0.0), good)

    return one_by_one(one, (frames, starts), BATCH)


# 7 parameters, traced and static ones
def normals(
    body: Body, options: IcpOptions, frames: FitFrames, at: Placed, x: Float[Array, " free"], maps: Maps,
    objective: Objective,
) -> Normals:  # fmt: skip
    """Gauss-Newton sums of all frames at rest `at` x, by forward derivatives (one tangent per parameter)."""

    def one(inputs):
        frame, rest, good = inputs

        def residuals(x):
            by = changes_at(maps, x)
            new, changed_to = changed(body, by), changed_options(options, by)
            r = frame_residuals(
                new, changed_to, frame, carried(rest, frame_problem(new, changed_to, frame, by)), objective
            )
            return r, r

        by_x, r = jax.jacfwd(residuals, has_aux=True)(x)
        fine = good & jnp.all(jnp.isfinite(by_x))
        r, by_x = jnp.where(good, r, 0.0), jnp.where(fine, by_x, 0.0)
        return Normals(*(jnp.matmul(by_x.T, v, precision="highest") for v in (r, by_x)))

    return one_by_one(one, (frames, at.rest, at.converged), BATCH)
