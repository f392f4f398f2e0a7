"""One frame as the fixed point of the ICP step, with exact derivatives: for gradients rather than for speed."""

import optimistix as optx

from voodoo_jax.geometry.rigid import Poses, quat_normalize
from voodoo_jax.solve.frame import FrameResult, icp_step
from voodoo_jax.solve.pulls import Problem


def _iterate(poses: Poses, problem: Problem) -> Poses:
    return icp_step(poses, problem)[0]


def solve_fixed_point(
    start: Poses,
    problem: Problem,
    tolerance: float = 1e-6,
    max_steps: int = 256,
    adjoint: optx.AbstractAdjoint | None = None,
) -> FrameResult:
    """The poses that a step leaves as they are, with exact derivatives by the implicit function theorem.

    For gradients rather than for speed: iterates until no component moves by more than `tolerance` (quaternion
    components and metres), and differentiates the fixed point, not the way to it, in forward and reverse mode. The
    derivative is right only where `converged` is true (docs/numerics.md#convergence), and is zero for `start`
    (docs/numerics.md#start); matches between points and limbs are held fixed (docs/numerics.md#matches).
    """
    solver = optx.FixedPointIteration(rtol=0.0, atol=tolerance)
    adjoint = adjoint or optx.ImplicitAdjoint()
    found = optx.fixed_point(_iterate, solver, start, problem, adjoint=adjoint, max_steps=max_steps, throw=False)
    # one more normalisation: the adjoint differentiates the last iterate as it is
    poses = Poses(quat_normalize(found.value.rotation), found.value.translation)
    return FrameResult(poses, found.stats["num_steps"], found.result == optx.RESULTS.successful)
