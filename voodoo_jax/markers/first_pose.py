"""A first pose from named points alone: without a floor, an upright person or a known upward direction. Host side,
NumPy.

The rest pose is aligned with the points by consensus (random samples of three). Then every limb is rotated about its
joint, from the root outwards, to its own points and those of its children. Wrong names are outvoted.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.robust import geman_mcclure
from voodoo_jax.kernels.landmarks import named_points
from voodoo_jax.model.body import Body, tree_levels

TO_START = 6  # named points of known places in a frame to start from


def rigid(
    model: Float[np.ndarray, "*b point 3"], data: Float[np.ndarray, "*b point 3"], weight: Float[np.ndarray, "*b point"]
) -> tuple[Float[np.ndarray, "*b 3 3"], Float[np.ndarray, "*b 3"]]:
    """Rotations and translations that take model points to data points in weighted least squares (Kabsch 1976)."""
    w = weight[..., None] / np.maximum(weight.sum(-1), 1e-12)[..., None, None]
    m, d = (w * model).sum(-2), (w * data).sum(-2)
    u, _, vt = np.linalg.svd(np.swapaxes(w * (data - d[..., None, :]), -1, -2) @ (model - m[..., None, :]))
    flip = np.ones(u.shape[:-1])
    flip[..., 2] = np.sign(np.linalg.det(u @ vt))
    turn = (u * flip[..., None, :]) @ vt
    return turn, d - np.einsum("...ij,...j->...i", turn, m)


def _robust(model, data, weight, reach, turn, shift):
    """rigid(), repeated with points that disagree counting less; `reach` metres count a quarter."""
    for _ in range(8):
        e2 = np.sum((model @ np.swapaxes(turn, -1, -2) + shift[..., None, :] - data) ** 2, -1)
        turn, shift = rigid(model, data, weight * geman_mcclure(e2, reach))
    return turn, shift


def agreed(
    model: Float[np.ndarray, "point 3"], data: Float[np.ndarray, "point 3"], scaled_by: float | None = None
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"], float]:
    """Rotation, translation and scale that move most of the model points near their data points.

    `scaled_by` the scale, if it is known.
    """
    rng = np.random.default_rng(0)
    triples = np.argsort(rng.random((1500, len(model))), 1)[:, :3]
    sides = lambda p: np.linalg.norm(p[triples] - p[np.roll(triples, 1, 1)], axis=-1)  # noqa: E731
    a, b = sides(model), sides(data)
    size = np.full(len(triples), scaled_by) if scaled_by else np.clip(b.sum(1) / np.maximum(a.sum(1), 1e-6), 0.3, 3.0)
    spread = float(np.linalg.norm(np.ptp(model, axis=0)))
    likely = (np.abs(b - size[:, None] * a).max(1) < 0.15 * spread * size) & (a.min(1) > 0.03 * spread)
    likely = likely if likely.any() else np.ones(len(triples), bool)
    triples, size = triples[likely], size[likely]
    turn, shift = rigid(size[:, None, None] * model[triples], data[triples], np.ones((len(triples), 3)))
    placed = size[:, None, None] * np.einsum("tij,pj->tpi", turn, model) + shift[:, None]
    e2 = np.sum((placed - data) ** 2, -1)
    # relative to the size tried: else a tiny body would be near everything
    best = int(np.argmax(np.sum(geman_mcclure(e2, 0.05 * spread * size[:, None]), 1)))
    factor = float(size[best])
    reach = 0.05 * spread * factor
    turn, shift = _robust(factor * model, data, np.ones(len(model)), reach, turn[best], shift[best])
    return turn, shift, factor


def first_poses(
    body: Body,
    rows: Int[np.ndarray, " point"],
    data: Float[np.ndarray, "frame point 3"],
    seen: Bool[np.ndarray, "frame point"],
    scaled_by: float | None = None,
    trust: Float[np.ndarray, " point"] | None = None,
) -> tuple[Float[np.ndarray, "frame limb 3 3"], Float[np.ndarray, "frame limb 3"], Float[np.ndarray, " frame"]]:
    """Rotations and places of the limbs in each frame from named points, and the scale relative to the body's.

    **Arguments:** `rows` of kernels.landmarks.named_points; `data` world frame, metres; `seen` False: missing.
    `scaled_by` the scale, if it is known; `trust` weights of the points, 1 where their places on the body are known.
    Needs three points that are seen in each frame.
    """
    limbs, places = (np.asarray(x) for x in named_points(body))
    limb, place = limbs[rows], places[rows].astype(np.float64)
    data = np.where(seen[..., None], data, 0.0).astype(np.float64)
    t = body.topology
    rest_turn = Rotation.from_quat(np.asarray(body.rest.rotation), scalar_first=True).as_matrix()
    rest_at = np.asarray(body.rest.translation, np.float64)
    model = np.einsum("pij,pj->pi", rest_turn[limb], place) + rest_at[limb]
    trust = np.ones(len(limb)) if trust is None else trust
    sure = seen & (trust >= 1)
    sure = np.where(sure.sum(1, keepdims=True) >= TO_START, sure, seen)
    begun = [agreed(model[use], points[use], scaled_by) for use, points in zip(sure, data)]
    turn, shift, factor = (np.stack(x) for x in zip(*begun))
    f, weight = factor[:, None, None], seen * trust
    model = f * model  # [frame, point, 3]
    middle = (seen[..., None] * model).sum(1) / seen.sum(1)[:, None]
    held = (middle, (turn @ middle[..., None])[..., 0] + shift, turn)
    # world rotation of the rest pose's frame, limb by limb; place of its joint
    turns, out_at = (np.zeros((len(data), body.limb_count, *shape)) for shape in ((3, 3), (3,)))
    turns[:, 0], root = _turned(model, data, weight * (limb == 0), *held, 0.1, 0.0)
    out_at[:, 0] = (turns[:, 0] @ (factor[:, None] * rest_at[0])[..., None])[..., 0] + root
    parents, children = np.array(t.parents, int), np.array(t.children, int)
    on_parent, on_child = (np.asarray(a.translation, np.float64) for a in (body.parent_anchor, body.child_anchor))
    mine = 1.0 * (limb == children[:, None])  # [joint, point]: on the joint's child
    own = mine + 0.15 * (parents == children[:, None]) @ mine  # and, weakly, on the limbs that hang on that
    for joints in tree_levels(t):
        p, c = parents[joints], children[joints]
        at = f * (np.einsum("jab,jb->ja", rest_turn[p], on_parent[joints]) + rest_at[p])
        placed = np.einsum("fjab,fjb->fja", turns[:, p] @ rest_turn[p], f * on_parent[joints]) + out_at[:, p]
        held = (at, placed, turns[:, p])
        turns[:, c], _ = _turned(model[:, None], data[:, None], weight[:, None] * own[joints], *held, 0.02, 8.0)
        out_at[:, c] = placed - np.einsum("fjab,fjb->fja", turns[:, c] @ rest_turn[c], f * on_child[joints])
    return turns @ rest_turn, out_at, factor


# 8 parameters: points, and what holds them
def _turned(model, data, weight, middle, at, before, about: float, pinned: float):
    """Rotations and translations of limbs from the rest pose, by their points. The point `middle` is held at the place
    `at` with the weight `pinned`, and the limb in the rotation `before` with the weight `about`."""
    frame = 0.15 * np.concatenate([np.eye(3), -np.eye(3), np.zeros((1, 3))])
    held = frame @ np.swapaxes(before, -1, -2) + at[..., None, :]
    wide = (*at.shape[:-1], model.shape[-2], 3)
    points = np.concatenate([np.broadcast_to(model, wide), frame + middle[..., None, :]], -2)
    targets = np.concatenate([np.broadcast_to(data, wide), held], -2)
    weights = np.concatenate([weight, np.broadcast_to([*[about] * 6, pinned], (*at.shape[:-1], 7))], -1)
    return _robust(points, targets, weights, 0.25, *rigid(points, targets, weights))
