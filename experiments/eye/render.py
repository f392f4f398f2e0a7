"""Depth and labels of meshes and boxes before a camera, compiled loops."""

import numpy as np
from numba import njit  # pyright: ignore[reportMissingImports]


@njit(cache=True)
def triangles(points, faces, labels, u0, v0, du, dv, depth, label):  # pragma: no cover  compiled
    """Lowers `depth` [row, column] where a triangle (optical frame) is nearer, and sets its label; pixel (0, 0) looks
    along (u0, v0, 1), its neighbours are du and dv farther."""
    height, width = depth.shape
    for t in range(len(faces)):
        a, b, c = points[faces[t, 0]], points[faces[t, 1]], points[faces[t, 2]]
        if min(a[2], b[2], c[2]) < 0.1:
            continue
        ax, ay = (a[0] / a[2] - u0) / du, (a[1] / a[2] - v0) / dv
        bx, by = (b[0] / b[2] - u0) / du, (b[1] / b[2] - v0) / dv
        cx, cy = (c[0] / c[2] - u0) / du, (c[1] / c[2] - v0) / dv
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            continue
        low, high = max(0, int(np.ceil(min(ay, by, cy)))), min(height - 1, int(np.floor(max(ay, by, cy))))
        left, right = max(0, int(np.ceil(min(ax, bx, cx)))), min(width - 1, int(np.floor(max(ax, bx, cx))))
        for y in range(low, high + 1):
            for x in range(left, right + 1):
                first = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                second = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                third = 1 - first - second
                if first < 0 or second < 0 or third < 0:
                    continue
                z = 1 / (first / a[2] + second / b[2] + third / c[2])
                if z < depth[y, x]:
                    depth[y, x], label[y, x] = z, labels[t]


@njit(cache=True)
def boxes(middle, axes, half, labels, u0, v0, du, dv, depth, label):  # pragma: no cover  compiled
    """The same for boxes: `middle` [box, 3] in the optical frame, `axes` [box, 3, 3] rows, `half` [box, 3] metres."""
    height, width = depth.shape
    for k in range(len(middle)):
        m, radius = middle[k], np.sqrt((half[k] * half[k]).sum())
        low, high, left, right = 0, height - 1, 0, width - 1
        if m[2] > 1.2 * radius + 0.2:
            far = 1.1 * radius / (m[2] - radius)
            low = max(low, int(((m[1] / m[2]) - far * (1 + abs(m[1] / m[2])) - v0) / dv))
            high = min(high, int(((m[1] / m[2]) + far * (1 + abs(m[1] / m[2])) - v0) / dv) + 1)
            left = max(left, int(((m[0] / m[2]) - far * (1 + abs(m[0] / m[2])) - u0) / du))
            right = min(right, int(((m[0] / m[2]) + far * (1 + abs(m[0] / m[2])) - u0) / du) + 1)
        elif m[2] < -radius:
            continue
        start = axes[k] @ (-m)
        for y in range(low, high + 1):
            for x in range(left, right + 1):
                u, v = u0 + x * du, v0 + y * dv
                near, far_ = 0.1, depth[y, x]
                for i in range(3):
                    way = axes[k, i, 0] * u + axes[k, i, 1] * v + axes[k, i, 2]
                    if abs(way) < 1e-9:
                        if abs(start[i]) > half[k, i]:
                            near = np.inf
                        continue
                    one, two = (-half[k, i] - start[i]) / way, (half[k, i] - start[i]) / way
                    near, far_ = max(near, min(one, two)), min(far_, max(one, two))
                if 0.1 < near < far_:
                    depth[y, x], label[y, x] = near, labels[k]
