"""The step in Numba: limb by limb over arrays of points, which the compiler does eight at a time; or point by point,
as one would write it first. Points in parts, each on a thread of its own; only moments are kept."""

import os
from collections.abc import Callable
from functools import cache

import numpy as np

from experiments.bench.peers.numpy_step import Pose
from experiments.bench.work import LEAST, RATIO, REACH, STEPS, Work


@cache
def _kernel(threads: int, by_point: bool):
    os.environ["NUMBA_NUM_THREADS"] = str(threads)
    from numba import njit, prange  # pyright: ignore[reportMissingImports]

    @njit(fastmath=True, error_model="numpy")
    def part_of(size, R, t, frame, reach2, first, last, sums):
        """Adds the moments of some of the points."""
        count = last - first
        best, who = np.full(count, reach2, np.float32), np.full(count, len(t), np.int32)
        cx, cy, cz = np.zeros(count, np.float32), np.zeros(count, np.float32), np.zeros(count, np.float32)
        x, y, z = frame[0, first:last], frame[1, first:last], frame[2, first:last]
        one, zero, tiny = np.float32(1), np.float32(0), np.float32(1e-12)
        for l in range(len(t)):
            r, p = R[l], t[l]
            ia0, ib0 = one / (size[l, 0] * size[l, 0]), one / (size[l, 1] * size[l, 1])
            ia1, ib1, length = one / (size[l, 2] * size[l, 2]), one / (size[l, 3] * size[l, 3]), size[l, 4]
            for i in range(count):
                dx, dy, dz = x[i] - p[0], y[i] - p[1], z[i] - p[2]
                px = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
                py = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
                pz = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
                u, v = px * px, py * py
                k0, k1 = one / np.sqrt(u * ia0 + v * ib0 + tiny), one / np.sqrt(u * ia1 + v * ib1 + tiny)
                rho2, slope = u + v + tiny, k1 - k0
                s = (rho2 * (one - k0) * slope + pz * length) / (rho2 * slope * slope + length * length)
                s = min(max(s, zero), one)
                k, g = k0 + s * slope, pz - s * length
                d2 = rho2 * (one - k) * (one - k) + g * g
                near = d2 < best[i]
                best[i] = d2 if near else best[i]
                cx[i] = k * px if near else cx[i]
                cy[i] = k * py if near else cy[i]
                cz[i] = s * length if near else cz[i]
                who[i] = l if near else who[i]
        for i in range(count):
            m = sums[who[i]]
            c, p4 = (one, cx[i], cy[i], cz[i]), (one, x[i], y[i], z[i])
            for a in range(4):
                for b in range(4):
                    m[a, b] += c[a] * p4[b]

    @njit(fastmath=True, error_model="numpy")
    def part_by_point(size, R, t, frame, reach2, first, last, sums):
        """Adds the moments of some of the points."""
        one, zero, tiny = np.float32(1), np.float32(0), np.float32(1e-12)
        for i in range(first, last):
            best, who, cx, cy, cz = reach2, len(t), zero, zero, zero
            for l in range(len(t)):
                r, p = R[l], t[l]
                dx, dy, dz = frame[0, i] - p[0], frame[1, i] - p[1], frame[2, i] - p[2]
                px = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
                py = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
                pz = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
                rho = np.sqrt(px * px + py * py + tiny)
                co, si, length = px / rho, py / rho, size[l, 4]
                q0 = one / np.sqrt((co / size[l, 0]) ** 2 + (si / size[l, 1]) ** 2)
                slope = one / np.sqrt((co / size[l, 2]) ** 2 + (si / size[l, 3]) ** 2) - q0
                s = min(max(((rho - q0) * slope + pz * length) / (slope * slope + length * length), zero), one)
                q, g = q0 + s * slope, pz - s * length
                d2 = (rho - q) * (rho - q) + g * g
                if d2 < best:
                    best, who, cx, cy, cz = d2, l, q * co, q * si, s * length
            m, c, p4 = sums[who], (one, cx, cy, cz), (one, frame[0, i], frame[1, i], frame[2, i])
            for a in range(4):
                for b in range(4):
                    m[a, b] += c[a] * p4[b]

    add_part = part_by_point if by_point else part_of

    @njit(parallel=threads > 1)
    def moments(size, R, t, frame, reach2):
        points = frame.shape[1]
        parts = np.zeros((threads, len(t) + 1, 4, 4), np.float32)
        for part in prange(threads):
            add_part(size, R, t, frame, reach2, part * points // threads, (part + 1) * points // threads, parts[part])
        for part in range(1, threads):
            parts[0] += parts[part]
        return parts[0][: len(t)]

    @njit
    def add_bands(m, R, t, parent, child, pa, pc, weight):
        n = np.maximum(m[:, 0, 0], LEAST)
        for j in range(len(parent)):
            for own, other, mine, theirs in ((parent[j], child[j], pa[j], pc[j]), (child[j], parent[j], pc[j], pa[j])):
                for b in range(4):
                    w = weight[j, b] * RATIO * n[own]
                    m[own, 0, 0] += w
                    for i in range(3):
                        m[own, i + 1, 0] += w * mine[b, i]
                    for k in range(3):
                        p = t[other, k]
                        for i in range(3):
                            p += R[other, k, i] * theirs[b, i]
                        m[own, 0, k + 1] += w * p
                        for i in range(3):
                            m[own, i + 1, k + 1] += w * mine[b, i] * p

    @njit
    def solve(m, R, t):
        """Absolute orientation: Newton on the characteristic polynomial, then the null space by inverse iteration."""
        k = np.empty((4, 4))
        for l in range(len(m)):
            w = max(m[l, 0, 0], 1e-6)
            s = np.empty((3, 3))
            for i in range(3):
                for j in range(3):
                    s[i, j] = m[l, i + 1, j + 1] / w - (m[l, i + 1, 0] / w) * (m[l, 0, j + 1] / w)
            trace = s[0, 0] + s[1, 1] + s[2, 2]
            k[0, 0] = trace
            for i in range(3):
                k[0, i + 1] = k[i + 1, 0] = s[(i + 1) % 3, (i + 2) % 3] - s[(i + 2) % 3, (i + 1) % 3]
                for j in range(3):
                    k[i + 1, j + 1] = s[i, j] + s[j, i] - (trace if i == j else 0.0)
            a, c1 = k.copy(), -np.trace(k)
            for i in range(4):
                a[i, i] += c1
            a = k @ a
            c2 = -np.trace(a) / 2
            for i in range(4):
                a[i, i] += c2
            a = k @ a
            c3 = -np.trace(a) / 3
            for i in range(4):
                a[i, i] += c3
            c4 = -np.trace(k @ a) / 4
            root = np.sqrt(-1.5 * c2 + 1e-30)
            for _ in range(40):
                change = ((((root + c1) * root + c2) * root + c3) * root + c4) / (
                    ((4 * root + 3 * c1) * root + 2 * c2) * root + c3
                )
                root -= change
                if abs(change) < 1e-12 * root:
                    break
            a = k.copy()
            for i in range(4):
                a[i, i] -= root * (1 + 1e-9) + 1e-15
            q = np.linalg.solve(a, np.linalg.solve(a, np.array([1.0, 0.1, 0.1, 0.1])) * 1e-6)
            q /= np.sqrt((q * q).sum())
            qw, x, y, z = q
            R[l, 0, 0], R[l, 0, 1], R[l, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - qw * z), 2 * (x * z + qw * y)
            R[l, 1, 0], R[l, 1, 1], R[l, 1, 2] = 2 * (x * y + qw * z), 1 - 2 * (x * x + z * z), 2 * (y * z - qw * x)
            R[l, 2, 0], R[l, 2, 1], R[l, 2, 2] = 2 * (x * z - qw * y), 2 * (y * z + qw * x), 1 - 2 * (x * x + y * y)
            for i in range(3):
                t[l, i] = (
                    m[l, 0, i + 1] - R[l, i, 0] * m[l, 1, 0] - R[l, i, 1] * m[l, 2, 0] - R[l, i, 2] * m[l, 3, 0]
                ) / w

    @njit
    def all_frames(size, R, t, parent, child, pa, pc, weight, frames, reach2):
        for f in range(len(frames)):
            for _ in range(STEPS):
                m = moments(size, R, t, frames[f], reach2)
                add_bands(m, R, t, parent, child, pa, pc, weight)
                solve(m, R, t)

    return all_frames


def build(work: Work, points: int, threads: int = 2, by_point: bool = False) -> Callable[[], Pose]:
    """All frames, one after the other; poses after the last."""
    frames, kernel, weight = work.frames(points), _kernel(threads, by_point), work.band_weight.astype(np.float32)

    def run() -> Pose:
        R, t = work.R.copy(), work.t.copy()
        bands = work.parent, work.child, work.pa, work.pc, weight
        kernel(work.size, R, t, *bands, frames, np.float32(REACH * REACH))
        return R, t

    return run
