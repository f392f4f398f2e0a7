"""How well a limb fits an image: edge and surface scores, points, occlusion (Hecht et al. 2009, sec. III-B)."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from voodoo_jax.trackers.flexible.cylinders import (
    Segments,
    all_limb_segments,
    limb_segments,
    segment_distance,
    skull_segment,
)
from voodoo_jax.trackers.flexible.flexible_body import IS_ARM, LIMBS, LOWER, UPPER, FlexibleBody
from voodoo_jax.trackers.flexible.physics import Frames, length

RINGS = 10  # reference colours along a cylinder, by the paper
ALONG, ACROSS = 6, 3  # samples of a cylinder's surface: set by hand, the study's
SHRINK = 4  # by hand: the occlusion map's pixels are each so many of the features'
_BEHIND = 0.12  # metres: what is so much farther than a surface ought to be is not it; cylinders are no people, by hand
_HAND_SAMPLES = 5  # along a hand, by hand
_HIDDEN_SKIN = 0.3  # score of a sample of a hand that is not seen, by hand
_NEVER = 1e6  # metres, by hand: nothing is so far


class View(NamedTuple):
    """Features of one frame as a program takes them; see image_features.Features."""

    colour: UInt8[Any, "row column 3"]
    edge: UInt8[Any, "row column"]
    motion: UInt8[Any, "coarse_row coarse_column"]
    flow: Float[Any, "coarse_row coarse_column 2"]
    depth: Float[Any, "row column"]
    focal: Float[Any, "4"]
    turn: Float[Any, "3 3"]
    shift: Float[Any, "3"]
    skin: UInt8[Any, "row column"]  # 255: surely, if it is the person's


class Weighing(NamedTuple):
    """What the scores weigh in the logarithm of a particle's weight, and what hidden samples score. Traced."""

    edge: Float[Array, ""]
    surface: Float[Array, ""]
    depth: Float[Array, ""]
    points: Float[Array, ""]
    skin: Float[Array, ""]  # of hands
    hidden_edge: Float[Array, ""]
    hidden_surface: Float[Array, ""]
    colour_scale: Float[Array, ""]  # share of full brightness, summed over channels
    seen_length: Float[Array, ""]  # 1: scores weigh by the length of limb that is seen; 0: means, as in the paper
    unseen: Float[Array, ""]  # what length that is not seen scores then, share of what hidden samples score
    cap: Float[Array, ""]  # metres: farther points tell no more


def project(view: View, p: Float[Array, "*n 3"]) -> tuple[Float[Array, "*n 2"], Float[Array, "*n"]]:
    """Pixels of the features and depth, metres."""
    q = p @ view.turn.T + view.shift
    z = jnp.maximum(q[..., 2], 0.1)
    return q[..., :2] / z[..., None] * view.focal[:2] + view.focal[2:], z


def read(image: Any, at: Float[Array, "*n 2"]) -> tuple[Array, Bool[Array, "*n"]]:
    """The nearest pixels, and whether they are inside of the image."""
    rows, columns = image.shape[:2]
    u, v = jnp.round(at[..., 0]).astype(int), jnp.round(at[..., 1]).astype(int)
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    return jnp.asarray(image)[jnp.clip(v, 0, rows - 1), jnp.clip(u, 0, columns - 1)], inside


def occlusion(body: FlexibleBody, x: Float[Array, "16 3"], view: View) -> Float[Array, "4 row column"]:
    """For each limb, on a coarse grid, how near the other parts of the body are (metres; far where there is none).

    The parts are convex quadrilaterals: projected cylinders and torso patches, each with its least depth along it.
    """
    limbs, skull = all_limb_segments(body, x), skull_segment(body, x)
    a = jnp.concatenate([limbs.a[:, :2].reshape(8, 3), skull.a[None]])
    b = jnp.concatenate([limbs.b[:, :2].reshape(8, 3), skull.b[None]])
    radii = jnp.concatenate([limbs.radii[:, :2].reshape(8, 2), skull.radii[None]])
    (pa, za), (pb, zb) = project(view, a), project(view, b)
    line = pb - pa
    side = jnp.stack([-line[:, 1], line[:, 0]], -1) / jnp.maximum(jnp.linalg.norm(line, axis=-1, keepdims=True), 1e-3)
    f = view.focal[0]
    ra, rb = (f * radii[:, 0] / za)[:, None], (f * radii[:, 1] / zb)[:, None]
    quads = jnp.stack([pa + side * ra, pb + side * rb, pb - side * rb, pa - side * ra], 1)
    near = jnp.minimum(za - radii[:, 0], zb - radii[:, 1])
    patches = jnp.stack([x[jnp.array([c[0], c[2], c[3], c[1]])] for c in (UPPER, LOWER)])
    pc, zc = project(view, patches)
    quads, near = jnp.concatenate([quads, pc]), jnp.concatenate([near, zc.min(-1) - body.torso[1]])
    rows, columns = view.depth.shape[0] // SHRINK, view.depth.shape[1] // SHRINK
    v, u = jnp.mgrid[:rows, :columns]
    grid = (jnp.stack([u, v], -1) + 0.5) * SHRINK - 0.5
    edge = jnp.roll(quads, -1, 1) - quads
    off = grid[None, None] - quads[:, :, None, None]
    cross = edge[:, :, None, None, 0] * off[..., 1] - edge[:, :, None, None, 1] * off[..., 0]
    inside = jnp.all(cross >= 0, 1) | jnp.all(cross <= 0, 1)  # [part, row, column]
    depth = jnp.where(inside, near[:, None, None], _NEVER)
    owner = jnp.concatenate([jnp.repeat(jnp.arange(4), 2), jnp.array([-1, -1, -1])])
    return jnp.stack([jnp.min(jnp.where((owner == limb)[:, None, None], _NEVER, depth), 0) for limb in range(4)])


class Samples(NamedTuple):
    """Places on the projected cylinders of a limb. Axes: cylinder (2), along, across (or the two borders)."""

    surface: Float[Array, "2 along across 2"]  # pixels
    border: Float[Array, "2 along 2 2"]
    depth: Float[Array, "2 along"]  # of the surface, metres
    seen: Float[Array, "2"]  # length that is seen, share of the cylinder's whole length


def samples(view: View, s: Segments) -> Samples:
    """The regular grid on the simplified projection of a limb's first two cylinders."""
    t = (jnp.arange(ALONG) + 0.5) / ALONG
    axis = s.a[:2, None] + t[:, None] * (s.b[:2] - s.a[:2])[:, None]
    radius = s.radii[:2, :1] + t * (s.radii[:2, 1:] - s.radii[:2, :1])
    at, z = project(view, axis)
    line = at[:, -1] - at[:, 0]
    along = jnp.sqrt(jnp.sum(line**2, -1, keepdims=True) + 1e-6)
    side = (jnp.stack([-line[:, 1], line[:, 0]], -1) / along)[:, None]
    wide = (view.focal[0] * radius / z)[..., None]
    across = jnp.linspace(-0.7, 0.7, ACROSS)
    surface = at[:, :, None] + across[:, None] * (side * wide)[:, :, None]
    border = jnp.stack([at + side * wide, at - side * wide], 2)
    whole = length(s.b[:2] - s.a[:2])[:, 0]
    seen = along[:, 0] / (1 - 1 / ALONG) / view.focal[0] * z.mean(1) / whole
    return Samples(surface, border, z - radius, jnp.clip(seen, 0.0, 1.0))


class LimbContext(NamedTuple):
    """What the weights of one limb's particles refer to; leading axis limb in filters."""

    hidden: Float[Array, "row column"]  # see occlusion
    colours: Float[Array, "2 ring 3"]  # reference, 0..1
    learnt: Float[Array, "2 ring"]  # how many frames' worth; 0: no reference
    points: Float[Array, "point 3"]
    others: Float[Array, "point"]  # distance of each point to the other parts, metres
    share: Float[Array, "point"]  # what each point weighs; 0: none
    forward: Float[Array, "3"]  # of the lower torso
    is_arm: Float[Array, ""]
    radii: Float[Array, "3 2"]
    tip: Float[Array, ""]
    head: Float[Array, "4"]  # the head point, and how near to it skin may be the face's, metres


class Score(NamedTuple):
    """Parts of a particle's weight, 0..1 each; `points` mean squared distance over the cap squared, less is better;
    `skin` of hands, 0 for feet."""

    edge: Float[Array, "*n"]
    surface: Float[Array, "*n"]
    depth: Float[Array, "*n"]
    points: Float[Array, "*n"]
    skin: Float[Array, "*n"]


def expected(colours: Float[Array, "2 ring 3"]) -> Float[Array, "2 along 3"]:
    """Reference colours at the samples, linearly between rings."""
    t = (jnp.arange(ALONG) + 0.5) / ALONG * RINGS - 0.5
    low = jnp.clip(jnp.floor(t).astype(int), 0, RINGS - 2)
    share = jnp.clip(t - low, 0, 1)[:, None]
    return colours[:, low] * (1 - share) + colours[:, low + 1] * share


def limb_score(p: Float[Array, "3 3"], context: LimbContext, view: View, w: Weighing) -> Score:
    """How well a limb's three points fit what is seen."""
    segments = limb_segments(p, context.forward, context.is_arm, context.radii, context.tip)
    at = samples(view, segments)
    # a sample is hidden where another part of the body is nearer, or outside of the image
    nearest, _ = read(context.hidden, (at.surface - (SHRINK - 1) / 2) / SHRINK)
    behind = nearest < at.depth[..., None] - 0.02
    depth, inside = read(view.depth, at.surface)
    covered = (depth > 0) & (depth < at.depth[..., None] - _BEHIND)
    visible = inside & ~behind & ~covered
    colour, _ = read(view.colour, at.surface)
    off = jnp.sum(jnp.abs(colour.astype(jnp.float32) / 255 - expected(context.colours)[:, :, None]), -1)
    known = jnp.minimum(context.learnt.mean(1), 1.0)[:, None, None]
    alike = known * jnp.exp(-off / w.colour_scale) + (1 - known) * w.hidden_surface
    surface = jnp.where(visible, alike, w.hidden_surface).mean((1, 2))
    there = jnp.where(depth > at.depth[..., None] + _BEHIND, 0.0, 1.0)
    solid = jnp.where(inside & ~behind & (depth > 0), jnp.where(covered, 0.6, there), 0.6).mean((1, 2))
    edge, inside = read(view.edge, at.border)
    nearest, _ = read(context.hidden, (at.border - (SHRINK - 1) / 2) / SHRINK)
    shown = inside & (nearest >= at.depth[..., None] - 0.02)
    edge = jnp.where(shown, edge.astype(jnp.float32) / 255, w.hidden_edge).mean((1, 2))
    share = w.seen_length * at.seen + (1 - w.seen_length)
    weighed = lambda s, default: jnp.mean(share * s + (1 - share) * w.unseen * default)  # noqa: E731
    d = jnp.minimum(jnp.min(jnp.abs(segment_distance(segments, context.points)), 1), context.others)
    near = jnp.minimum(d, w.cap) / w.cap
    points = jnp.sum(context.share * near**2) / jnp.maximum(jnp.sum(context.share), 1e-6)
    return Score(
        weighed(edge, w.hidden_edge), weighed(surface, w.hidden_surface), weighed(solid, 0.6), points,
        context.is_arm * _hand_score(segments, context, view),
    )  # fmt: skip


def _hand_score(s: Segments, context: LimbContext, view: View) -> Float[Array, ""]:
    """Share of skin on a hand as far as it is seen, and not before the face."""
    t = (jnp.arange(_HAND_SAMPLES) + 0.5)[:, None] / _HAND_SAMPLES
    hand = s.a[2] + t * (s.b[2] - s.a[2])
    at, z = project(view, hand)
    z = z - s.radii[2, 1]
    nearest, _ = read(context.hidden, (at - (SHRINK - 1) / 2) / SHRINK)
    depth, inside = read(view.depth, at)
    seen = inside & (nearest >= z - 0.02) & ~((depth > 0) & (depth < z - _BEHIND))
    away = (depth > 0) & (depth > z + _BEHIND)  # of the room behind
    skin = jnp.where(away, 0.0, read(view.skin, at)[0].astype(jnp.float32) / 255)
    seen &= length(hand - context.head[:3])[:, 0] > context.head[3]  # else the face draws hands that are not seen
    return jnp.where(seen, skin, _HIDDEN_SKIN).mean()


def log_weight(score: Score, w: Weighing) -> Float[Array, "*n"]:
    """Logarithm of a particle's weight."""
    return (
        w.edge * score.edge + w.surface * score.surface + w.depth * score.depth - w.points * score.points
        + w.skin * score.skin
    )  # fmt: skip


# 7 parameters: model, state and measurements, traced each
def learn(
    body: FlexibleBody, x: Float[Array, "16 3"], frames: Frames, view: View, colours: Float[Array, "4 2 ring 3"],
    learnt: Float[Array, "4 2 ring"], rate: Float[Array, "4 2"],
) -> tuple[Array, Array]:  # fmt: skip
    """Reference colours with one more image: a running average over the pixels of each ring that are the person's.

    **Arguments:** `rate` what the image counts on each cylinder, from the local confidence; 0: nothing is learnt.
    """
    arm = jnp.asarray(IS_ARM, x.dtype)
    segments = jax.vmap(limb_segments, (0, None, 0, 0, 0))(x[LIMBS], frames.lower[0], arm, body.radii, body.tips)
    at = jax.vmap(samples, (None, 0))(view, segments)
    hidden = occlusion(body, x, view)
    nearest = jax.vmap(lambda image, place: read(image, (place - (SHRINK - 1) / 2) / SHRINK)[0])(hidden, at.surface)
    depth, inside = read(view.depth, at.surface)
    good = inside & (nearest >= at.depth[..., None] - 0.02) & (depth > 0)
    good &= jnp.abs(depth - at.depth[..., None]) < _BEHIND
    colour = read(view.colour, at.surface)[0].astype(jnp.float32) / 255
    to_ring = np.zeros((ALONG, RINGS), np.float32)
    # each ring takes from the nearest sample along the limb
    to_ring[np.clip(np.round((np.arange(RINGS) + 0.5) / RINGS * ALONG - 0.5).astype(int), 0, ALONG - 1),
            np.arange(RINGS)] = 1  # fmt: skip
    count = good.sum(-1).astype(jnp.float32) @ to_ring
    total = jnp.einsum("lsac,ar->lsrc", jnp.sum(jnp.where(good[..., None], colour, 0.0), -2), to_ring)
    mean = total / jnp.maximum(count, 1.0)[..., None]
    step = jnp.where(count > 0, rate[..., None], 0.0)
    now = learnt + step
    share = (step / jnp.maximum(now, 1e-6))[..., None]
    return colours + share * (mean - colours), now


def drawn(key: Array, weights: Float[Any, "n"], count: int) -> Int[Array, " count"]:
    """Random indices in proportion to weights: cumulative sum and search; a categorical draw would make one random
    number for every index and draw."""
    total = jnp.cumsum(weights)
    return jnp.searchsorted(total, jax.random.uniform(key, (count,)) * total[-1]).clip(0, len(weights) - 1)


def systematic(key: Array, weights: Float[Array, "n"]) -> Int[Array, " n"]:
    """Systematic resampling."""
    n = len(weights)
    total = jnp.cumsum(weights)
    places = (jnp.arange(n) + jax.random.uniform(key)) / n * total[-1]
    return jnp.searchsorted(total, places).clip(0, n - 1)
