"""The step in plain NumPy, vectorised over limbs and points."""

from collections.abc import Callable

import numpy as np

from experiments.bench.work import LEAST, RATIO, REACH, STEPS, Work

Pose = tuple[np.ndarray, np.ndarray]  # R [limb, 3, 3] and t [limb, 3] of T_world_limb, metres


def closest(size, x, y, z):
    """Closest points on the sides by polar angle and squared distances; `size` [limb, 5, 1], others [limb, point]."""
    a0, b0, a1, b1, length = (size[:, i] for i in range(5))
    rho = np.sqrt(x * x + y * y + np.float32(1e-12))
    co, si = x / rho, y / rho
    q0 = 1 / np.sqrt((co / a0) ** 2 + (si / b0) ** 2)
    slope = 1 / np.sqrt((co / a1) ** 2 + (si / b1) ** 2) - q0
    s = np.clip(((rho - q0) * slope + z * length) / (slope * slope + length * length), 0, 1)
    r, cz = q0 + s * slope, s * length
    return r * co, r * si, cz, (rho - r) ** 2 + (z - cz) ** 2


def band_moments(work: Work, R, t, weight):
    """Sums of w [1, c] [1, p]^T of all bands [limb, 4, 4]; c in the limb's frame, p in the world."""
    count = len(t)
    strength = np.float32(RATIO) * np.maximum(weight, np.float32(LEAST))
    out = np.zeros((count, 4, 4), np.float32)
    one = np.ones((*work.bm.shape, 1), np.float32)
    ends = ((work.parent, work.pa), (work.child, work.pc))
    for (own, mine), (other, theirs) in (ends, ends[::-1]):
        place = np.einsum("jik,jbk->jbi", R[other], theirs) + t[other][:, None]
        c, p = np.concatenate([one, mine], -1), np.concatenate([one, place], -1)
        w = work.band_weight * strength[own][:, None]
        np.add.at(out, own, np.einsum("jb,jbi,jbk->jik", w, c, p))
    return out


def horn(m) -> Pose:
    """Absolute orientation of every limb from its moments [limb, 4, 4] (Horn 1987)."""
    m = m.astype(np.float64)
    w = np.maximum(m[:, 0, 0], 1e-6)
    model, data = m[:, 1:, 0] / w[:, None], m[:, 0, 1:] / w[:, None]
    s = m[:, 1:, 1:] / w[:, None, None] - model[:, :, None] * data[:, None]
    k = np.empty((len(s), 4, 4))
    trace = np.trace(s, axis1=1, axis2=2)
    turn = np.stack([s[:, 1, 2] - s[:, 2, 1], s[:, 2, 0] - s[:, 0, 2], s[:, 0, 1] - s[:, 1, 0]], -1)
    k[:, 0, 0], k[:, 0, 1:], k[:, 1:, 0] = trace, turn, turn
    k[:, 1:, 1:] = s + s.transpose(0, 2, 1) - trace[:, None, None] * np.eye(3)
    q = np.linalg.eigh(k)[1][:, :, -1]
    w, x, y, z = q.T
    R = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                  2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                  2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1).reshape(-1, 3, 3)  # fmt: skip
    t = data - np.einsum("lik,lk->li", R, model)
    return R.astype(np.float32), t.astype(np.float32)


def step(work: Work, R, t, frame) -> Pose:
    """One step; `frame` [3, point]."""
    local = np.einsum("lki,lkn->lin", R, frame[None] - t[:, :, None], optimize=True)
    cx, cy, cz, d2 = closest(work.size[:, :, None], *local.transpose(1, 0, 2))
    limb, at = d2.argmin(0), np.arange(frame.shape[1])
    near = d2[limb, at] < REACH * REACH
    model = np.stack([near, cx[limb, at] * near, cy[limb, at] * near, cz[limb, at] * near], 1).astype(np.float32)
    data = np.concatenate([np.ones((1, len(at)), np.float32), frame])
    outer = (model[:, :, None] * data.T[:, None]).reshape(-1, 16)
    mine = (np.arange(len(t))[:, None] == limb).astype(np.float32)
    moments = (mine @ outer).reshape(-1, 4, 4)
    return horn(moments + band_moments(work, R, t, moments[:, 0, 0]))


def build(work: Work, points: int) -> Callable[[], Pose]:
    """All frames, one after the other; poses after the last."""
    frames = work.frames(points)

    def run() -> Pose:
        R, t = work.R, work.t
        for frame in frames:
            for _ in range(STEPS):
                R, t = step(work, R, t, frame)
        return R, t

    return run
