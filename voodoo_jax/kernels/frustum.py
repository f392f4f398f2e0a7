"""Closest point on a degenerated cylinder: an elliptic frustum with its two end caps (Knoop 2007, sec. 4).

The side is the ruled surface (a(s) cos t, b(s) sin t, s L) with a, b linear in s from 0 (bottom) to 1 (top).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

# A radius or length of zero is legal (cones, discs, needles); below this it counts as this, metres.
TINY = 1e-6
FLAT, EDGE = 0.999, 1e-6  # of the squared radius, of the length: where closest points are on a cap, not on its rim
# a0, b0, a1, b1, length in metres, of one limb or point by point; and the rims' factors, see rim_factors
Rims = Float[Array, "4"] | Sequence[Float[Array, "*point"]]
Size = Float[Array, "5"] | Float[Array, "5 point"] | Sequence[Float[Array, "*point"]]


class Sides(NamedTuple):
    """Where on its limb a point's pair is: what jumps from one place to another as a limb moves."""

    bottom: Bool[Array, "*limb point"]  # on the cap at the bottom
    top: Bool[Array, "*limb point"]
    behind: Bool[Array, "*limb point"]  # moved to the side that the sensor sees, see near_side


class SurfacePoint(NamedTuple):
    """Closest points in the limb frame, metres."""

    x: Float[Array, " point"]
    y: Float[Array, " point"]
    z: Float[Array, " point"]
    distance: Float[Array, " point"]  # signed: negative inside the limb
    sides: Sides


def _ellipse_step(a, b, px, py, cos, sin):
    """One step towards the closest point of an ellipse for a point in the first quadrant.

    Replaces the ellipse by its circle of curvature: needs no bracket and cannot find the wrong root as Newton's
    method can (docs/numerics.md#ellipses).
    """
    ex, ey = (a * a - b * b) * cos**3 / a, (b * b - a * a) * sin**3 / b  # centre of curvature
    rx, ry, qx, qy = a * cos - ex, b * sin - ey, px - ex, py - ey
    q2 = qx * qx + qy * qy
    # at the centre of curvature no direction is better than the one at hand
    lost = q2 < 1e-16
    ratio = jnp.sqrt((rx * rx + ry * ry + 1e-20) / jnp.where(lost, 1.0, q2))
    c, s = jnp.clip((qx * ratio + ex) / a, 0.0, 1.0), jnp.clip((qy * ratio + ey) / b, 0.0, 1.0)
    n2 = c * c + s * s
    lost = lost | (n2 < 1e-12)
    norm = jnp.sqrt(jnp.where(lost, 1.0, n2))
    return jnp.where(lost, cos, c / norm), jnp.where(lost, sin, s / norm)


def _refine(size, px, py, z, first, iterations):
    """Alternates between the angle (closest point of the ellipse at s) and s (closest point of the generator line).

    Starts from the first guess and, half way round the quadrant, from both rims, and keeps the best: a flat limb has
    several local minima, and a point inside it would run to the tip of the ellipse from most other angles.
    """
    a0, b0, a1, b1, length = size
    x0, y0, s0 = first
    s = jnp.stack([s0, jnp.zeros_like(s0), jnp.ones_like(s0)])
    a, b = a0 + s * (a1 - a0), b0 + s * (b1 - b0)
    diagonal = jnp.array([[False], [True], [True]])
    cos, sin = jnp.where(diagonal, 1.0, x0 / a), jnp.where(diagonal, 1.0, y0 / b)
    norm = jnp.sqrt(cos * cos + sin * sin + 1e-20)
    cos, sin = cos / norm, sin / norm
    for _ in range(iterations):
        cos, sin = _ellipse_step(a, b, px, py, cos, sin)
        gx, gy = (a1 - a0) * cos, (b1 - b0) * sin
        along = (px - a0 * cos) * gx + (py - b0 * sin) * gy + z * length
        s = jnp.clip(along / (gx * gx + gy * gy + length * length), 0.0, 1.0)
        a, b = a0 + s * (a1 - a0), b0 + s * (b1 - b0)
    x, y = a * cos, b * sin
    best = jnp.argmin((px - x) ** 2 + (py - y) ** 2 + (z - s * length) ** 2, 0)[None]
    return tuple(jnp.take_along_axis(v, best, 0)[0] for v in (x, y, s))


def rim_factors(size: Size) -> tuple[Float[Array, "*point"], ...]:
    """1/a0^2, 1/b0^2, 1/a1^2, 1/b1^2: what closest points need of the rims; per square metre."""
    return tuple(1 / jnp.square(jnp.maximum(size[i], TINY)) for i in range(4))


def uncut(*numbers: Array) -> Any:
    """No cut, see kernels.assignment.cuts."""
    return numbers


# 10 parameters: points and a limb's sizes by component
def _closest(size, rims, x, y, z, refine, caps, cut=uncut, alone=False, fixed=None):
    """Closest points, their squared distances, which points are inside, and which are on the caps. `alone`: distances
    alone are wanted, and their values, not their derivatives; `fixed`: Sides that are settled."""
    a0, b0, a1, b1, length = (jnp.maximum(size[i], TINY) for i in range(5))
    centre = x * x + y * y < 1e-14  # no direction: take +x, with a gradient of zero
    # an addition costs a fifth less than a choice, but gives no direction
    dx, dy = (x + 1e-10, y) if alone else (jnp.where(centre, 1e-7, x), jnp.where(centre, 0.0, y))
    u, v = dx * dx, dy * dy
    rho2 = u + v

    # the generator through the point's polar angle, a straight line in the half plane (rho, z); radii of both rims
    # there as multiples of the point's own: two inverse roots and one division are all that is slow
    k0 = lax.rsqrt(u * rims[0] + v * rims[1])
    k1 = lax.rsqrt(u * rims[2] + v * rims[3])
    k0, k1 = cut(k0, k1)
    slope = k1 - k0
    (s,) = cut((rho2 * ((1 - k0) * slope) + z * length) / (rho2 * (slope * slope) + length * length))
    s = jnp.clip(s, 0.0, 1.0)
    k = k0 + s * slope
    cx, cy = k * dx, k * dy
    if refine:
        sx, sy = jnp.where(x < 0, -1.0, 1.0), jnp.where(y < 0, -1.0, 1.0)
        cx, cy, s = _refine((a0, b0, a1, b1, length), x * sx, y * sy, z, (cx * sx, cy * sy, s), refine)
        cx, cy, cz = cx * sx, cy * sy, s * length
        d2 = (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2
    else:
        cz = s * length
        d2 = rho2 * (1 - k) ** 2 + (z - cz) ** 2
    if not caps:
        nowhere = jnp.zeros_like(centre)
        return (cx, cy, cz), d2, nowhere, (nowhere, nowhere)

    # caps: straight below or above, where the point's shadow falls into the ellipse
    down2, up2 = z * z, (z - length) ** 2
    bottom = (k0 >= 1) & (down2 < d2) if fixed is None else fixed.bottom
    d2 = jnp.where(bottom, down2, d2)
    top = (k1 >= 1) & (up2 < d2) if fixed is None else fixed.top
    d2 = jnp.where(top, up2, d2)
    flat = bottom | top
    cx, cy = jnp.where(flat, x, cx), jnp.where(flat, y, cy)
    cz = jnp.where(top, length, jnp.where(bottom, 0.0, cz))
    level = z * (1 / length)
    az, bz = a0 + level * (a1 - a0), b0 + level * (b1 - b0)
    inside = (z > 0) & (z < length) & (u * (bz * bz) + v * (az * az) < (az * bz) ** 2)
    return (cx, cy, cz), d2, inside, (bottom, top)


# 9 parameters: points and a limb's sizes by component
def closest_point(
    size: Size,
    x: Float[Array, " point"],
    y: Float[Array, " point"],
    z: Float[Array, " point"],
    refine: int = 0,
    caps: bool = True,
    rims: Rims | None = None,
    cut: Callable = uncut,
    fixed: Sides | None = None,
) -> SurfacePoint:
    """Closest points on the frustum's surface, end caps included.

    **Arguments:** `size` a0, b0, a1, b1, length in metres, of one limb or point by point; `x, y, z` points in the
    limb frame, metres; `refine`
    iterations towards the exact closest point of an elliptic cross-section. 0 keeps the polar angle of the point:
    exact for round limbs; for the built-in human, within 10 cm of a limb, the distance is off by 0.3 mm on average,
    2 mm at 95 %, 23 mm at worst (deep inside the pelvis). 8 iterations: to 0.2 mm for a
    human's limbs, 1 mm for short tapering ones (tests/kernels/test_surface.py); `caps` false: the side alone, an open
    tube that has no inside; `rims` rim_factors of the size, where they are known already; `cut` see
    kernels.assignment.cuts; `fixed` where on the limb the pairs are, if that is settled.

    **Returns:** closest points and signed distances. At the axis, where several points are closest, one of them.
    """
    rims = rim_factors(size) if rims is None else rims
    found, d2, inside, caps_of = _closest(size, rims, x, y, z, refine, caps, cut, fixed=fixed)
    zero = d2 < 1e-16
    distance = jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, d2)))
    x, y, z = cut(*found)
    return SurfacePoint(x, y, z, jnp.where(inside, -distance, distance), Sides(*caps_of, jnp.zeros_like(inside)))


# 7 parameters: points and a limb's sizes by component
def signed_square(
    size: Size,
    x: Float[Array, " point"],
    y: Float[Array, " point"],
    z: Float[Array, " point"],
    refine: int = 0,
    caps: bool = True,
    rims: Rims | None = None,
) -> Float[Array, " point"]:
    """Squared distances to the surface, negative inside: in the same order as the distances, and without their roots.
    See closest_point."""
    rims = rim_factors(size) if rims is None else rims
    _, d2, inside, _ = _closest(size, rims, x, y, z, refine, caps, alone=True)
    return jnp.where(inside, -d2, d2)


# 7 parameters: points and a limb's sizes by component
def near_side(
    size: Size,
    x: Float[Array, " point"],
    y: Float[Array, " point"],
    surface: SurfacePoint,
    sensor: Sequence[Float[Array, " point"]],
    cut: Callable = uncut,
    fixed: Sides | None = None,
) -> SurfacePoint:
    """Moves correspondences from the side that the sensor cannot see to the side that it sees.

    A measured point was on the surface that faces its sensor. Where the point lies behind the limb's axis, the
    closest point would be on the far side and pull the limb away from the sensor; instead the point keeps its lateral
    offset and takes the near surface there. Not on an end cap that the sensor sees, which has no far side. `sensor`:
    x, y, z of each point's sensor in the limb frame, metres; `fixed` see closest_point.
    """
    a0, b0, a1, b1, length = (jnp.maximum(size[i], TINY) for i in range(5))
    s = surface.z / length
    a, b = cut(a0 + s * (a1 - a0), b0 + s * (b1 - b0))
    per_a, per_b = cut(1 / a, 1 / b)  # divisions are slow
    u, v = cut(sensor[0] * per_a, sensor[1] * per_b)  # scaled so that the ellipse is the unit circle: lines stay lines
    n2 = u * u + v * v
    seen_from_end = n2 < 1e-8  # the sensor looks along the limb: no near side
    per_n = lax.rsqrt(jnp.where(seen_from_end, 1.0, n2))
    u, v = u * per_n, v * per_n
    x, y = x * per_a, y * per_b
    depth, lateral = x * u + y * v, y * u - x * v
    within = (surface.x * per_a) ** 2 + (surface.y * per_b) ** 2 < FLAT
    on_cap = within & jnp.where(sensor[2] < 0, s < EDGE, (s > 1 - EDGE) & (sensor[2] > length))
    behind = (depth < 0) & ~seen_from_end & ~on_cap if fixed is None else fixed.behind
    (lateral,) = cut(lateral)
    lateral = jnp.clip(lateral, -1.0, 1.0)
    rest = 1.0 - lateral * lateral
    front = jnp.where(rest > 1e-12, jnp.sqrt(jnp.where(rest > 1e-12, rest, 1.0)), 0.0)
    cx, cy = a * (front * u - lateral * v), b * (front * v + lateral * u)
    x, y = cut(jnp.where(behind, cx, surface.x), jnp.where(behind, cy, surface.y))
    return surface._replace(x=x, y=y, sides=surface.sides._replace(behind=behind))
