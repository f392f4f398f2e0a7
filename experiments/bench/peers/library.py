"""This library's own step on the work: its kernels with open limbs, no prior, no robust weights."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.bench.peers.numpy_step import Pose
from experiments.bench.work import LEAST, RATIO, REACH, STEPS, Work
from voodoo_jax.config.options import SolveSettings, TrackSettings
from voodoo_jax.geometry.rigid import Poses, matrix
from voodoo_jax.kernels.points import Points
from voodoo_jax.model.body import Body, Links
from voodoo_jax.model.body_file import load_body
from voodoo_jax.solve.frame import icp_step
from voodoo_jax.solve.pulls import IcpOptions, Problem
from voodoo_jax.solve.scan import options_from

Solver = Literal["per_limb", "coupled"]


def options(solver: Solver, points: int) -> IcpOptions:
    """The work's rules as the library's options."""
    solve = SolveSettings(
        solver=solver, ratio=RATIO, floor=LEAST / points, prior=0.0, steady=0.0, epsilon=0.0, max_steps=STEPS,
        max_distance=REACH, robust_scale=float("inf"), limb_enlarge=REACH, body_enlarge=REACH, overlap="exclusive",
        near_side=False, refine=0, limits=0.0, collisions=0.0, sampling=1.0, damping=1e-4,
    )  # fmt: skip
    icp = options_from(solve, TrackSettings()).icp
    return eqx.tree_at(lambda o: o.match, icp, replace(icp.match, caps=False))


def body_of(work: Work) -> Body:
    """A body with the work's limbs and joints; of the papers' body all that the step does not look at is left."""
    body, count = load_body("human10"), len(work.t)
    joints = tuple(work.parent.tolist()), tuple(work.child.tolist())
    topology = body.topology._replace(limbs=tuple(map(str, range(count))), parents=joints[0], children=joints[1])
    return replace(body, sizes=jnp.asarray(work.size), presence=jnp.ones(count), topology=topology)


def start_of(work: Work) -> Poses:
    """Poses before the first frame."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(work.R).as_quat(scalar_first=True)
    return Poses(jnp.asarray(q, jnp.float32), jnp.asarray(work.t))


def links_of(work: Work) -> Links:
    """The work's bands."""
    first, second, one, two = (jnp.asarray(v) for v in (work.parent, work.child, work.pa, work.pc))
    return Links(first, second, one, two, jnp.asarray(work.band_weight, jnp.float32))


def track(
    body: Body,
    links: Links,
    icp: IcpOptions,
    start: Poses,
    frames: jax.Array,
    steps: int = STEPS,
    weight: jax.Array | None = None,
) -> Poses:
    """All frames [frame, 3, point] of one stream, their points weighed alike or by `weight` [point]; poses after the
    last."""
    points = frames.shape[-1]
    weight = jnp.ones(points) if weight is None else weight
    rest = weight, jnp.zeros(points, jnp.int32), jnp.zeros((1, 3))

    def one(poses, frame):
        problem = Problem(body, links, Points(frame.T, *rest), None, poses, icp)
        poses = jax.lax.fori_loop(0, steps, lambda _, p: icp_step(p, problem)[0], poses)
        return poses, None

    return jax.lax.scan(one, start, frames)[0]


def build(
    work: Work, points: int, solver: Solver = "per_limb", streams: int = 1, steps: int = STEPS, spread: float = 1.0
) -> Callable[[], Pose]:
    """All frames of `streams` streams at once; poses of the first stream after the last frame. `spread`: times the
    lightest points' weight, that of the heaviest."""
    body, links, icp, start = body_of(work), links_of(work), options(solver, points), start_of(work)
    frames = jnp.asarray(work.frames(points))
    weight = None if spread == 1 else spread ** jax.random.uniform(jax.random.key(0), (points,))
    one = partial(track, steps=steps, weight=weight)
    if streams > 1:
        start = jax.tree.map(lambda x: jnp.repeat(x[None], streams, 0), start)
        frames = jnp.repeat(frames[None], streams, 0)
        program = jax.jit(jax.vmap(one, (None, None, None, 0, 0)))
    else:
        program = jax.jit(one)
    program = program.lower(body, links, icp, start, frames).compile()

    def run() -> Pose:
        poses = jax.block_until_ready(program(body, links, icp, start, frames))
        if streams > 1:
            poses = poses[0]
        return np.asarray(matrix(poses.rotation)), np.asarray(poses.translation)

    return run
