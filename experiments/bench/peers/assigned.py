"""What ICP libraries are given: each frame's points by limb, assigned beforehand, and limbs as clouds."""

from collections.abc import Callable

import numpy as np

from experiments.bench.peers.numpy_step import Pose, closest, step
from experiments.bench.work import REACH, STEPS, Work

SAMPLES = 1000  # points on a limb's surface
LEAST_POINTS = 20  # a limb with fewer stays where it is: small_gicp asks for so many


def surface(size: np.ndarray, count: int = SAMPLES) -> np.ndarray:
    """Points [count, 3] on a limb's side, limb frame, evenly spread over height and angle."""
    i = np.arange(count)
    angle, s = i * np.pi * (3 - 5**0.5), (i + 0.5) / count
    a, b = size[0] + s * (size[2] - size[0]), size[1] + s * (size[3] - size[1])
    return np.stack([a * np.cos(angle), b * np.sin(angle), s * size[4]], -1)


def by_limb(work: Work, points: int) -> list[tuple[Pose, list[np.ndarray]]]:
    """For each frame the poses before it, and the points [point, 3] of each limb."""
    R, t, out = work.R, work.t, []
    for frame in work.frames(points):
        local = np.einsum("lki,lkn->lin", R, frame[None] - t[:, :, None])
        d2 = closest(work.size[:, :, None], *local.transpose(1, 0, 2))[3]
        limb, near = d2.argmin(0), d2.min(0) < REACH * REACH
        out.append(((R, t), [frame[:, near & (limb == l)].T.astype(float) for l in range(len(t))]))
        for _ in range(STEPS):
            R, t = step(work, R, t, frame)
    return out


def run_by_limb(work: Work, points: int, align: Callable[[int, np.ndarray, np.ndarray], np.ndarray]) -> Callable:
    """All frames; `align(limb, points [point, 3], T_limb_world before [4, 4])` gives T_limb_world."""
    frames = by_limb(work, points)
    starts = []
    for (R, t), _ in frames:
        T = np.tile(np.eye(4), (len(t), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = R.transpose(0, 2, 1), -np.einsum("lki,lk->li", R, t)
        starts.append(T)

    def run() -> Pose:
        T = starts[0]
        for (_, limbs), start in zip(frames, starts):
            T = np.stack([align(l, p, start[l]) if len(p) >= LEAST_POINTS else start[l] for l, p in enumerate(limbs)])
        R = T[:, :3, :3].transpose(0, 2, 1)
        return R, -np.einsum("lik,lk->li", R, T[:, :3, 3])

    return run
