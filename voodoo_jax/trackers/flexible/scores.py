"""Scores of limbs in an image: edges, surface, points, occlusion (Hecht et al. 2009, sec. III-B)."""

from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt8, UInt32

from voodoo_jax.trackers.flexible.cylinders import Segment, body_segments, limb_segments, segment_distance
from voodoo_jax.trackers.flexible.flexible_body import IS_ARM, LIMBS, LOWER, OTHER_SIDE, UPPER, FlexibleBody
from voodoo_jax.trackers.flexible.image_features import COARSE
from voodoo_jax.trackers.flexible.physics import Frames, Limb
from voodoo_jax.trackers.flexible.vectors import Vector, kept, turned, vectors

RINGS = 10  # reference colours along a cylinder, from the paper
ALONG, ACROSS = 6, 3  # samples of a cylinder's surface: set by hand
# metres: depth within this distance of a cylinder belongs to its surface, since people are not cylinders. Measured:
# 0.08 and 0.18 give the same
_BEHIND = 0.12
_HAND_SAMPLES = 5  # along a hand, by hand
_HIDDEN_SKIN = 0.3  # score of a hidden sample of a hand; measured: 0.2 and 0.45 give the same
# weight of a frame's logarithm of a likelihood by the learned eye, since its errors in frames in a row are alike:
# chosen on half of experiments/stereo, for which way the body faces
COUNTS = 0.5
_NEVER = 1e6  # metres, farther than everything: any gives the same beyond the size of rooms


class View(NamedTuple):
    """Features of one frame as input of a program; see image_features.Features."""

    pixels: UInt32[Any, "row column"]  # bytes, lowest first: blue, green, red, edge: one lookup
    motion: UInt8[Any, "coarse_row coarse_column"]
    depth: Float[Any, "row column"]
    focal: Float[Any, "4"]
    turn: Float[Any, "3 3"]
    shift: Float[Any, "3"]
    skin: UInt8[Any, "row column"]  # 255: certain, if it belongs to the person
    there: Float[Any, ""] = np.float32(1)  # 0: this camera has no image in this frame
    more: "tuple[View, ...]" = ()  # views of further cameras; motion comes from the first one


class Weighing(NamedTuple):
    """Weights of the scores in the logarithm of a particle's weight, and scores of hidden samples. Traced."""

    edge: Float[Array, ""]
    surface: Float[Array, ""]
    depth: Float[Array, ""]
    points: Float[Array, ""]
    skin: Float[Array, ""]  # of hands
    hidden_edge: Float[Array, ""]
    hidden_surface: Float[Array, ""]
    colour_scale: Float[Array, ""]  # share of full brightness, summed over channels
    seen_length: Float[Array, ""]  # 1: scores are weighted by the visible length of the limb; 0: means, as in the paper
    unseen: Float[Array, ""]  # score of hidden length, as a share of the score of hidden samples
    cap: Float[Array, ""]  # metres: distances of points are capped here


class Place(NamedTuple):
    """Places in an image, pixels of the features, with their depths along the optical axis, metres."""

    u: Float[Array, "*n"]
    v: Float[Array, "*n"]
    z: Float[Array, "*n"]


def project(view: View, p: Vector) -> Place:
    """Projects points in the fixed frame into the image."""
    return _project_camera(view, turned(view.turn, p) + Vector(view.shift))


def _project_camera(view: View, q: Vector) -> Place:
    z = jnp.maximum(q.z, 0.1)
    return Place(q.x / z * view.focal[0] + view.focal[2], q.y / z * view.focal[1] + view.focal[3], z)


def read(image: Any, at: Place, shrunk: int = 1) -> tuple[Array, Bool[Array, "*n"]]:
    """The nearest pixels of an image that is `shrunk` times smaller than the features, and whether they are inside."""
    rows, columns = image.shape[:2]
    u, v = ((n - (shrunk - 1) / 2) / shrunk for n in at[:2])
    u, v = jnp.round(u).astype(jnp.int32), jnp.round(v).astype(jnp.int32)
    inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    number = jnp.clip(v, 0, rows - 1) * columns + jnp.clip(u, 0, columns - 1)
    flat = jnp.asarray(image).reshape(rows * columns, *image.shape[2:])
    return flat.at[number].get(mode="promise_in_bounds"), inside


def channels(pixels: UInt32[Array, "*n"]) -> tuple[Float[Array, "*n"], ...]:
    """Blue, green, red and edge of pixels, 0..1."""
    return tuple(((pixels >> (8 * n)) & 255).astype(jnp.float32) / 255 for n in range(4))


def occlusion(body: FlexibleBody, x: Float[Array, "16 3"], view: View) -> Float[Array, "4 row column"]:
    """For each limb, on a coarse grid, the depth of the nearest other part of the body, metres; _NEVER without one.

    Parts are convex quadrilaterals: projected cylinders and torso patches, each with its least depth.
    """
    cylinders = body_segments(body, vectors(x))
    shown = np.array([0, 1, 3, 4, 6, 7, 9, 10, 12])  # without hands and feet
    a, b = project(view, cylinders.a[shown]), project(view, cylinders.b[shown])
    begin, end = cylinders.begin[shown], cylinders.end[shown]
    line_u, line_v = b.u - a.u, b.v - a.v
    scale = view.focal[0] / jnp.maximum(jnp.sqrt(line_u**2 + line_v**2), 1e-3)
    ra, rb = scale * begin / a.z, scale * end / b.z
    near = jnp.minimum(a.z - begin, b.z - end)
    corner = project(view, vectors(x[np.array([[c[0], c[2], c[3], c[1]] for c in (UPPER, LOWER)])]))
    sides = ((a, ra, 1), (b, rb, 1), (b, rb, -1), (a, ra, -1))
    quad_u = jnp.stack([at.u - side * r * line_v for at, r, side in sides], 1)
    quad_v = jnp.stack([at.v + side * r * line_u for at, r, side in sides], 1)
    quad_u, quad_v = jnp.concatenate([quad_u, corner.u]), jnp.concatenate([quad_v, corner.v])
    near = jnp.concatenate([near, corner.z.min(-1) - body.torso[1]])
    rows, columns = view.depth.shape[0] // COARSE, view.depth.shape[1] // COARSE
    v, u = ((np.arange(n, dtype=np.float32) + 0.5) * COARSE - 0.5 for n in (rows, columns))
    # the side of an edge that a pixel is on: by_u u + by_v v + constant, a cross product
    by_u, by_v = quad_v - jnp.roll(quad_v, -1, 1), jnp.roll(quad_u, -1, 1) - quad_u
    constant = -(by_u * quad_u + by_v * quad_v)
    level = by_v[..., None] * v + constant[..., None]  # [part, edge, row]
    inside = partial(_fill_quadrilateral, u)
    depth = lax.map(lambda part: jnp.where(inside(*part[:2]), part[2], _NEVER), (level, by_u, near))
    own = np.arange(4)[:, None] == np.arange(len(near)) // 2  # the last parts, head and torso, belong to no limb
    return jnp.min(jnp.where(own[..., None, None], _NEVER, depth), 1)


def _fill_quadrilateral(
    u: Float[Any, " column"], level: Float[Array, "4 row"], by_u: Float[Array, "4"]
) -> Bool[Array, "row column"]:
    side = [level[k][:, None] + by_u[k] * u for k in range(4)]
    low, high = (of(of(side[0], side[1]), of(side[2], side[3])) for of in (jnp.minimum, jnp.maximum))
    return (low >= 0) | (high <= 0)


class Samples(NamedTuple):
    """Samples on the projected cylinders of limbs. Axes: cylinder (2), along, across (or the two borders), and those of
    the limbs."""

    surface: Place  # z: depth of the surface
    border: Place
    seen: Float[Array, "2 *n"]  # visible length, share of the cylinder's length


def samples(view: View, segments: tuple[Segment, Segment, Segment]) -> Samples:
    """A regular grid on the simplified projections of limbs' first two cylinders."""
    first, second, _ = segments
    begin, end = jnp.stack([first.begin, second.begin]), jnp.stack([first.end, second.end])
    a, b = (turned(view.turn, v) + Vector(view.shift) for v in (first.a.stack(second.a), first.b.stack(second.b)))
    d = b - a
    more = lambda n: np.reshape(n, (-1, *[1] * (a.ndim - 1)))  # noqa: E731
    begin, end = (r.reshape(*r.shape, *[1] * (a.ndim - r.ndim)) for r in (begin, end))
    t = more((np.arange(ALONG, dtype=np.float32) + 0.5) / ALONG)
    at = _project_camera(view, a[:, None] + d[:, None] * t)
    radius = begin[:, None] + t * (end - begin)[:, None]
    line_u, line_v = at.u[:, -1] - at.u[:, 0], at.v[:, -1] - at.v[:, 0]
    along = jnp.sqrt(line_u**2 + line_v**2 + 1e-6)
    wide = view.focal[0] * radius / at.z
    aside_u, aside_v = -(line_v / along)[:, None] * wide, (line_u / along)[:, None] * wide
    near = (at.z - radius)[:, :, None]

    def across(shares: np.ndarray) -> Place:
        return Place(at.u[:, :, None] + shares * aside_u[:, :, None], at.v[:, :, None] + shares * aside_v[:, :, None],
                     jnp.broadcast_to(near, (2, ALONG, len(shares), *at.u.shape[2:])))  # fmt: skip

    seen = along * (1 / (1 - 1 / ALONG)) / view.focal[0] * at.z.mean(1) / d.length()
    surface = across(more(np.linspace(-0.7, 0.7, ACROSS, dtype=np.float32)))
    return Samples(surface, across(more(np.array([1, -1], np.float32))), jnp.clip(seen, 0.0, 1.0))


class Guess(NamedTuple):
    """The body as the learned eye sees it in one frame alone."""

    x: Float[Any, "*point 3"]  # metres
    error: Float[Any, "*point"]  # expected distance from the truth, metres; infinite: not seen
    odds: Float[Any, ""]  # logarithm of the odds that left and right are so, by all frames so far


# of a frame in which the eye sees nobody: the place decides nothing, any gives the same
NO_GUESS = Guess(np.zeros((16, 3), np.float32), np.full(16, np.inf, np.float32), np.float32(0))


class LimbContext(NamedTuple):
    """Inputs of the weights of one limb's particles; leading axis limb in filters."""

    hidden: Float[Array, "row column"]  # see occlusion
    colours: Float[Array, "2 ring 3"]  # reference, 0..1
    learnt: Float[Array, "2 ring"]  # number of frames averaged; 0: no reference
    points: Float[Array, "point 3"]
    others: Float[Array, "point"]  # distance of each point to the other parts, metres
    share: Float[Array, "point"]  # weight of each point; 0: none
    beyond: Float[Array, "2"]  # of omitted points: sum of the shares, and sum of shares times costs
    forward: Float[Array, "3"]  # direction of the lower torso
    is_arm: Float[Array, ""]
    radii: Float[Array, "3 2"]
    tip: Float[Array, ""]
    head: Float[Array, "4"]  # the head point, and the radius around it in which skin may belong to the face, metres
    # the learned eye's, of the limb's points, metres, with left and right as this body has them; error infinite: none
    guess: Float[Any, "3 3"] = NO_GUESS.x[:3]
    error: Float[Any, "3"] = NO_GUESS.error[:3]
    more: tuple[Float[Array, "row column"], ...] = ()  # `hidden` in the views of further cameras


class Score(NamedTuple):
    """Parts of a particle's weight, 0..1 each; `points` mean squared distance over the squared cap, less is better;
    `skin` of hands, 0 for feet; `eye` logarithm of the likelihood by the learned eye, at most 0."""

    edge: Float[Array, "*n"]
    surface: Float[Array, "*n"]
    depth: Float[Array, "*n"]
    points: Float[Array, "*n"]
    skin: Float[Array, "*n"]
    eye: Float[Array, "*n"]


def expected(colours: Float[Array, "2 ring 3"]) -> Float[Array, "2 along 3"]:
    """Reference colours at the samples, interpolated linearly between rings."""
    t = (jnp.arange(ALONG) + 0.5) / ALONG * RINGS - 0.5
    low = jnp.clip(jnp.floor(t).astype(int), 0, RINGS - 2)
    share = jnp.clip(t - low, 0, 1)[:, None]
    return colours[:, low] * (1 - share) + colours[:, low + 1] * share


def limb_score(p: Limb, context: LimbContext, view: View, w: Weighing) -> Score:
    """Scores of many particles of one limb in the images and by the measured points."""
    there = view.focal[0] > 0
    return kept(there, lambda p, context: _limb_score(p, context, view, w), p, context)


def _limb_score(p: Limb, context: LimbContext, view: View, w: Weighing) -> Score:
    segments = limb_segments(p, vectors(context.forward), context.is_arm, context.radii, context.tip)
    seen = _image_score(segments, context, context.hidden, view, w)
    if view.more:
        each = [_image_score(segments, context, *other, w) for other in zip(context.more, view.more)]
        seen = jax.tree.map(lambda *parts: _average_views(parts, (view, *view.more)), seen, *each)
    eye = -reduce(jnp.add, map(unlike_guess, p, context.guess, context.error))
    return seen._replace(points=_points_score(segments, context, w), eye=eye)


def _average_views(parts: tuple[Array, ...], views: tuple[View, ...]) -> Array:
    """Mean over the cameras that have an image."""
    total = sum((part * view.there for part, view in zip(parts[1:], views[1:])), parts[0] * views[0].there)
    return total / jnp.maximum(sum(view.there for view in views), 1e-6)


def _image_score(
    segments: tuple[Segment, Segment, Segment], context: LimbContext, hidden: Array, view: View, w: Weighing
) -> Score:
    """Scores in one camera's image, without points."""
    at, there = samples(view, segments), view.focal[0] > 0
    surface, solid = kept(there, lambda at: _surface_scores(at, context, hidden, view, w), at.surface)
    pixels, inside = read(view.pixels, at.border)
    nearest, _ = read(hidden, at.border, COARSE)
    shown = inside & (nearest >= at.border.z - 0.02)
    edge = jnp.where(shown, channels(pixels)[3], w.hidden_edge).mean((1, 2))
    share = w.seen_length * at.seen + (1 - w.seen_length)
    weighed = lambda s, default: jnp.mean(share * s + (1 - share) * w.unseen * default, 0)  # noqa: E731
    skin = context.is_arm * _hand_score(segments[2], context, hidden, view)
    edge = weighed(edge, w.hidden_edge)
    none = jnp.zeros_like(edge)
    return Score(edge, weighed(surface, w.hidden_surface), weighed(solid, 0.6), none, skin, none)


def _surface_scores(
    at: Place, context: LimbContext, hidden: Array, view: View, w: Weighing
) -> tuple[Float[Array, "2 particle"], Float[Array, "2 particle"]]:
    """For each cylinder: similarity of its colours to the reference, and share of it at the measured depth."""
    # samples behind another part of the body, or outside of the image, are hidden
    nearest, _ = read(hidden, at, COARSE)
    behind = nearest < at.z - 0.02
    depth, inside = read(view.depth, at)
    covered = (depth > 0) & (depth < at.z - _BEHIND)
    visible = inside & ~behind & ~covered
    pixels, _ = read(view.pixels, at)
    reference = expected(context.colours)[:, :, None, None]
    off = sum(jnp.abs(value - reference[..., n]) for n, value in enumerate(channels(pixels)[:3]))
    known = jnp.minimum(context.learnt.mean(1), 1.0)[:, None, None, None]
    alike = known * jnp.exp(-off / w.colour_scale) + (1 - known) * w.hidden_surface
    surface = jnp.where(visible, alike, w.hidden_surface).mean((1, 2))
    there = jnp.where(depth > at.z + _BEHIND, 0.0, 1.0)
    solid = jnp.where(inside & ~behind & (depth > 0), jnp.where(covered, 0.6, there), 0.6).mean((1, 2))
    return surface, solid


def _points_score(
    segments: tuple[Segment, Segment, Segment], context: LimbContext, w: Weighing
) -> Float[Array, " particle"]:
    # points on the last axis: one particle's are computed together, too (measured: eight times faster)
    each = jax.tree.map(lambda a: a[..., None] if jnp.ndim(a) else a, segments)
    distances = [jnp.abs(segment_distance(s, vectors(context.points))) for s in each]
    d = reduce(jnp.minimum, distances, context.others)
    near = jnp.minimum(d, w.cap) / w.cap
    share, cost = context.beyond
    return (near**2 @ context.share + cost) / jnp.maximum(jnp.sum(context.share) + share, 1e-6)


def worthwhile(context: LimbContext, count: int, w: Weighing) -> LimbContext:
    """The context with only the `count` points that a limb can improve most: points explained by the rest of the body
    carry no information about the limb."""
    if len(context.others) <= count:
        return context
    cost = context.share * (jnp.minimum(context.others, w.cap) / w.cap) ** 2
    best = lax.top_k(cost, count)[1]
    share = context.share[best]
    beyond = context.beyond + jnp.stack([jnp.sum(context.share) - jnp.sum(share), jnp.sum(cost) - jnp.sum(cost[best])])
    return context._replace(
        points=context.points[best], others=context.others[best], share=share, beyond=jnp.maximum(beyond, 0.0)
    )


def _hand_score(s: Segment, context: LimbContext, hidden: Array, view: View) -> Float[Array, " particle"]:
    """Share of skin on the visible samples of a hand that are not in front of the face."""
    t = (np.arange(_HAND_SAMPLES, dtype=np.float32) + 0.5)[:, None] / _HAND_SAMPLES
    hand = s.a[None] + (s.b - s.a)[None] * t
    at = project(view, hand)
    z = at.z - s.end
    nearest, _ = read(hidden, at, COARSE)
    depth, inside = read(view.depth, at)
    seen = inside & (nearest >= z - 0.02) & ~((depth > 0) & (depth < z - _BEHIND))
    away = (depth > 0) & (depth > z + _BEHIND)  # the room behind
    skin = jnp.where(away, 0.0, read(view.skin, at)[0].astype(jnp.float32) / 255)
    # otherwise the face attracts hidden hands
    seen &= (hand - vectors(context.head[:3])).length() > context.head[3]
    return jnp.where(seen, skin, _HIDDEN_SKIN).mean(0)


def log_weight(score: Score, w: Weighing) -> Float[Array, "*n"]:
    """Logarithm of a particle's weight."""
    return (
        w.edge * score.edge + w.surface * score.surface + w.depth * score.depth - w.points * score.points
        + w.skin * score.skin + score.eye
    )  # fmt: skip


def unlike_guess(at: Vector, guess: Float[Array, "3"], error: Float[Array, ""]) -> Float[Array, "*n"]:
    """How much the learned eye speaks against a point in some places: far off, by the distribution that it is trained
    with (Laplace); within its error hardly at all, since errors of points and frames are alike there."""
    far = (at - vectors(guess)).length() / error
    return COUNTS * (jnp.sqrt(1 + far * far) - 1)


def sided(guess: Guess, x: Float[Array, "16 3"]) -> tuple[Float[Array, "16 3"], Float[Array, " 16"], Float[Array, ""]]:
    """Points and errors of a guess with left and right as a body's trunk has them, and the logarithm of the probability
    of these."""
    log = -jnp.logaddexp(0.0, guess.odds * np.array([-1, 1], np.float32))
    orders, trunk = np.stack([np.arange(16, dtype=np.int32), OTHER_SIDE]), LIMBS[:, 0]
    each, error = guess.x[orders], guess.error[orders]
    against = jax.vmap(lambda at, *by: unlike_guess(vectors(at), *by))  # of each point of the trunk
    far = [against(x[trunk], at[trunk], off[trunk]).sum() for at, off in zip(each, error)]
    best = jnp.argmax(log - jnp.stack(far))
    return each[best], error[best], log[best]


# 8 parameters: model, state and measurements, traced each
def learn(
    body: FlexibleBody, x: Float[Array, "16 3"], frames: Frames, view: View, hidden: Float[Array, "4 row column"],
    colours: Float[Array, "4 2 ring 3"], learnt: Float[Array, "4 2 ring"], rate: Float[Array, "4 2"],
) -> tuple[Array, Array]:  # fmt: skip
    """Updates the reference colours by one image: a running average over the person's pixels in each ring.

    **Arguments:** `hidden` see occlusion; `rate` weight of the image on each cylinder, from the local confidence; 0:
    no update.
    """
    arm = jnp.asarray(IS_ARM, x.dtype)
    points = [vectors(x[LIMBS[:, n]]) for n in range(3)]
    segments = limb_segments((points[0], points[1], points[2]), vectors(frames.lower[0]), arm, body.radii, body.tips)
    at = samples(view, segments).surface
    nearest = jax.vmap(lambda image, place: read(image, place, COARSE)[0], (0, -1), -1)(hidden, at)
    depth, inside = read(view.depth, at)
    good = inside & (nearest >= at.z - 0.02) & (depth > 0) & (jnp.abs(depth - at.z) < _BEHIND)
    colour = jnp.stack(channels(read(view.pixels, at)[0])[:3], -1)
    to_ring = np.zeros((ALONG, RINGS), np.float32)
    # each ring reads the nearest sample along the limb
    to_ring[np.clip(np.round((np.arange(RINGS) + 0.5) / RINGS * ALONG - 0.5).astype(int), 0, ALONG - 1),
            np.arange(RINGS)] = 1  # fmt: skip
    count = jnp.einsum("sal,ar->lsr", good.sum(2).astype(jnp.float32), to_ring)
    total = jnp.einsum("salc,ar->lsrc", jnp.sum(jnp.where(good[..., None], colour, 0.0), 2), to_ring)
    mean = total / jnp.maximum(count, 1.0)[..., None]
    step = jnp.where(count > 0, rate[..., None], 0.0)
    now = learnt + step
    share = (step / jnp.maximum(now, 1e-6))[..., None]
    return colours + share * (mean - colours), now


def systematic(offset: Float[Array, ""], weights: Float[Array, "n"]) -> Int[Array, " n"]:
    """Indices by systematic resampling; `offset` random, 0..1."""
    n = len(weights)
    total = jnp.cumsum(weights)
    places = (jnp.arange(n) + offset) / n * total[-1]
    return jnp.searchsorted(total, places, method="compare_all").clip(0, n - 1)
