"""Losses of one frame, to be differentiated by a body: `vj.loss`."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from voodoo_jax.config.fit_options import FitSettings
from voodoo_jax.config.options import Settings
from voodoo_jax.fitting.frames import feature_names, fit_frames
from voodoo_jax.fitting.objective import NEWTON, POINT_SD, SETTLED, FitFrames, frame_residuals
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import Tracks, given_from
from voodoo_jax.solve.frame import IcpOptions, Problem
from voodoo_jax.solve.implicit import solution
from voodoo_jax.solve.scan import options_from


class LossFrame(eqx.Module):
    """One tracked frame: measurements that the pose is solved on, others that judge it, and how it is solved."""

    measured: FitFrames  # without leading axis
    options: IcpOptions


class loss:  # noqa: N801 (a namespace: vj.loss.reprojection)
    """Losses of one frame; everything between a body and them is differentiable.

    frame = vj.loss.frame(tracks, recording, 40)
    slope = jax.grad(lambda body: vj.loss.reprojection(body, frame))(tracks.body)
    """

    @staticmethod
    def frame(
        tracks: Tracks, recording: Recording, index: int, settings: Settings | None = None, points: int = 256
    ) -> LossFrame:
        """A frame of a tracked recording. The body's points are found anew, as `track` finds them.

        **Arguments:** `index` of the frame; `points` that the pose is solved on, at most, and as many that judge.

        Raises ValueError where that frame is not tracked.
        """
        from voodoo_jax.detect.pipeline import find_body

        settings = settings or Settings()
        if not tracks.tracked[index]:
            raise ValueError(f"frame {index} is not tracked; {int(tracks.tracked.sum())} others are (tracks.tracked)")
        _, seen = find_body(iter(recording), recording.up, tracks.body, settings, recording.up_is_given)
        near = given_from(tracks, -recording.origin)
        names = feature_names(list(seen), tracks.body.topology, settings.features)
        found = fit_frames(near, list(seen), np.array([index]), settings.features, names, 1, points)
        solve = replace(settings.solve, max_steps=FitSettings().steps, epsilon=0.0, steady=0.0)
        options = options_from(solve, settings.track, settings.features).icp
        return LossFrame(jax.tree.map(lambda leaf: leaf[0], found), options)

    @staticmethod
    def reprojection(body: Body, frame: LossFrame) -> Float[Array, ""]:
        """How far measurements that the pose was not solved on lie from the body: square metres, points and features in
        units of their noise, each limb as one measurement (see fitting/objective.py).

        The pose is solved on the other half with exact derivatives by all of the body (solve/implicit.py). NaN where it
        does not come to rest, for derivatives are wrong there.
        """
        return _reprojection()(body, frame)


@cache
def _reprojection() -> Callable[[Body, LossFrame], Float[Array, ""]]:
    """Compiled: op by op its derivative would take a minute."""

    def loss(body: Body, frame: LossFrame) -> Float[Array, ""]:
        measured, options = frame.measured, frame.options
        problem = Problem.build(body, measured.points, measured.poses, options, measured.features)
        found = solution(measured.poses, problem, newton=NEWTON, tolerance=SETTLED)
        residuals = frame_residuals(body, options, measured, found.poses, "held")
        return jnp.where(found.converged, POINT_SD**2 * jnp.sum(residuals**2), jnp.nan)

    return jax.jit(loss)
