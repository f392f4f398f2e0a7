"""Losses with derivatives by bodies and parameters: `vj.loss`."""

from collections.abc import Callable
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from voodoo_jax.fitting.objective import JOINT_NEAR, POINT_SD, FitFrames, as_distances, frame_residuals
from voodoo_jax.fitting.problem import Problem
from voodoo_jax.model.body import Body
from voodoo_jax.solve import frame as one_frame
from voodoo_jax.solve.implicit import solution
from voodoo_jax.solve.pulls import IcpOptions
from voodoo_jax.solve.through_time import Tracked


class LossFrame(eqx.Module):
    """One tracked frame: measurements for the pose, others that judge it, and the options of the solve."""

    measured: FitFrames  # without leading axis
    options: IcpOptions


class loss:  # noqa: N801 (a namespace: vj.loss.joints)
    """Losses to minimise: of a recording solved by `solved`, or of a single frame. Never NaN.

    problem = vj.problem(vj.human(), recording, truth="bow.truth.npz")
    jax.grad(lambda p: vj.loss.joints(vj.solved(p, problem), problem))({"lengths.thigh": 0.0, "bands.knee.weight": 0.0})
    """

    @staticmethod
    def joints(solved: Tracked, problem: Problem) -> Float[Array, ""]:
        """Mean distance of the joint centres from the truth, metres; quadratic far below 1 cm, so that it is smooth.
        Frames that are not at rest do not count. Raises ValueError for a problem without a truth."""
        frames = problem.frames
        if frames.truth is None or frames.known is None:
            raise ValueError("loss.joints needs known joints: vj.problem(..., truth=FILE)")
        there = frames.known & (solved.converged & (frames.weight > 0))[:, None]
        gap = jnp.where(there[..., None], solved.joints - problem.places - frames.truth, 0.0)
        away = jnp.sum(as_distances(gap) ** 2, -1) / (2 * JOINT_NEAR)
        return jnp.sum(jnp.where(there, away, 0.0)) / jnp.maximum(jnp.sum(there), 1)

    @staticmethod
    def points(solved: Tracked, problem: Problem) -> Float[Array, ""]:
        """Squared distance of held-back measurements from the body, square metres: the mean of `reprojection` over
        frames. `problem` with the parameters that it was solved with (`problem.having`)."""
        frames = problem.frames

        def one(inputs):
            frame, poses, good = inputs
            squares = jnp.sum(frame_residuals(problem.body, problem.options.icp, frame, poses, "held") ** 2)
            return jnp.where(good & (frame.weight > 0), POINT_SD**2 * squares, 0.0)

        counted = jnp.sum(solved.converged & (frames.weight > 0))
        return jnp.sum(jax.lax.map(one, (frames, solved.poses, solved.converged))) / jnp.maximum(counted, 1)

    @staticmethod
    def frame(problem: Problem, index: int) -> LossFrame:
        """A single frame of a problem, for `reprojection`; `index` among the problem's frames, from 0.

        Raises ValueError for an index out of range.
        """
        there = int((problem.frames.weight > 0).sum())
        if not 0 <= index < there:
            raise ValueError(f"frame {index}: the problem has the frames 0 to {there - 1}")
        # a single frame has no still neighbours, and takes all steps
        options = eqx.tree_at(lambda o: (o.steady, o.epsilon), problem.options.icp, (jnp.zeros(()), jnp.zeros(())))
        return LossFrame(jax.tree.map(lambda leaf: leaf[index], problem.frames), options)

    @staticmethod
    def reprojection(body: Body, frame: LossFrame) -> Float[Array, ""]:
        """Squared distance of held-back measurements from the body, square metres: points and features in units of
        their noise, each limb as one measurement (see fitting/objective.py).

        The pose is solved on the other half, with exact derivatives by the whole body (solve/implicit.py).
        """
        return _compile_reprojection()(body, frame)


@cache
def _compile_reprojection() -> Callable[[Body, LossFrame], Float[Array, ""]]:
    """The compiled loss: without compiling, its derivative takes a minute."""

    def loss(body: Body, frame: LossFrame) -> Float[Array, ""]:
        measured, options = frame.measured, frame.options
        problem = one_frame.Problem.build(body, measured.points, measured.poses, options, measured.features)
        found = solution(measured.poses, problem)
        residuals = frame_residuals(body, options, measured, found.poses, "held")
        return POINT_SD**2 * jnp.sum(residuals**2)

    return jax.jit(loss)
