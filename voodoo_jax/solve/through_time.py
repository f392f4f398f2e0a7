"""Whole tracking as one pure function: a body, options and a padded recording in, poses and joints of all frames out.

The scan over frames predicts each one from the last, as `scan.track_frame` does, with bands, priors, and limbs held
that stand still; each frame's solve is implicit (`implicit.solution`). All is differentiable in forward and in reverse
mode, by body, options and measurements alike, and may be mapped over bodies and recordings. On the way back a frame is
not solved once more: what it came to rest with is kept, and no more.

Outside stay what is found once in a recording: which points are the body's, start and size, the pass back in time, and
where joint centres are put beside the body's own (refine/place_joints): these go in as constants.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.kernels.landmarks import Features
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.solve.implicit import AT_REST, resting, with_derivatives
from voodoo_jax.solve.pulls import Chosen, anything_measured
from voodoo_jax.solve.scan import State, TrackOptions, frame_problem, state_after


class Measurements(eqx.Module):
    """A padded recording: a body's measurements, frame by frame."""

    points: Points  # leading axis: frame
    seconds: Float[Array, "*frame"]  # since the frame before
    valid: Bool[Array, "*frame"]  # False: padding
    features: Features | None


class Tracked(eqx.Module):
    """All frames of a recording, solved; leading axis: frame."""

    poses: Poses
    joints: Float[Array, "*frame centre 3"]  # the body's joint centres, metres
    off: Float[Array, "*frame"]  # see implicit.Solution
    converged: Bool[Array, "*frame"]  # derivatives of others are wrong
    changing: Int[Array, "*frame"]  # choices that the poses found would make otherwise, see implicit.Solution
    chosen: Chosen  # how points and features were matched


def track_through(
    body: Body, options: TrackOptions, start: State, measured: Measurements, tolerance: float = AT_REST
) -> Tracked:
    """Poses and joints of all frames from the state before the first one; `tolerance` see implicit.solution."""

    def one(state: State, frame: Measurements) -> tuple[State, Tracked]:
        problem, patient = frame_problem(body, options, state, frame.points, frame.seconds, frame.features)
        anything = anything_measured(problem)
        rest = resting(problem.predicted, problem, tolerance=tolerance, patient=patient)
        found = with_derivatives(rest, problem, tolerance)
        poses = jax.tree.map(lambda new, old: jnp.where(anything, new, old), found.poses, problem.predicted)
        good = anything & found.converged
        after = state_after(problem, options, state, poses, found.weight, frame.seconds, good)
        state = jax.tree.map(lambda new, old: jnp.where(frame.valid, new, old), after, state)
        joints = joint_centres(body, poses)
        return state, Tracked(poses, joints, found.off, good, found.changing, found.chosen)

    keep = jax.checkpoint_policies.save_only_these_names("rest")
    return jax.lax.scan(jax.checkpoint(one, prevent_cse=False, policy=keep), start, measured)[1]
