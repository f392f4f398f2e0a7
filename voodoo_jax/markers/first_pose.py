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
from voodoo_jax.model.body import Body, tree_order

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


def _robust(model, data, weight, reach: float, turn=None, shift=None):
    """rigid(), repeated with points that disagree counting less; `reach` metres count a quarter."""
    if turn is None:
        turn, shift = rigid(model, data, weight)
    for _ in range(8):
        e2 = np.sum((model @ turn.T + shift - data) ** 2, -1)
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


def first_pose(
    body: Body,
    rows: Int[np.ndarray, " point"],
    data: Float[np.ndarray, "point 3"],
    seen: Bool[np.ndarray, " point"],
    scaled_by: float | None = None,
    trust: Float[np.ndarray, " point"] | None = None,
) -> tuple[Float[np.ndarray, "limb 4"], Float[np.ndarray, "limb 3"], float]:
    """Rotations (wxyz) and places of the limbs from named points, and the scale relative to the body's.

    **Arguments:** `rows` of kernels.landmarks.named_points; `data` world frame, metres; `seen` False: missing.
    `scaled_by` the scale, if it is known; `trust` weights of the points, 1 where their places on the body are known.
    Needs three points that are seen.
    """
    limbs, places = (np.asarray(x) for x in named_points(body))
    limb, place, data = limbs[rows[seen]], places[rows[seen]].astype(np.float64), data[seen].astype(np.float64)
    rest_turn = Rotation.from_quat(np.asarray(body.rest.rotation), scalar_first=True).as_matrix()
    rest_at = np.asarray(body.rest.translation, np.float64)
    model = np.einsum("pij,pj->pi", rest_turn[limb], place) + rest_at[limb]
    trust = np.ones(len(limb)) if trust is None else trust[seen]
    sure = trust >= 1 if (trust >= 1).sum() >= TO_START else np.ones(len(limb), bool)
    turn, shift, factor = agreed(model[sure], data[sure], scaled_by)
    # world rotation of the rest pose's frame, limb by limb; place of its joint
    mine = model, data, limb, trust
    turns = {0: _limb_turn(*mine, [0], [], factor, turn, shift)}
    root_turn, root_shift = turns[0]
    out_turn, out_at = np.zeros((body.limb_count, 3, 3)), np.zeros((body.limb_count, 3))
    out_turn[0], out_at[0] = root_turn @ rest_turn[0], factor * root_turn @ rest_at[0] + root_shift
    t = body.topology
    parent_at, child_at = (np.asarray(a.translation, np.float64) for a in (body.parent_anchor, body.child_anchor))
    for j in tree_order(t):
        p, c = t.parents[j], t.children[j]
        joint_model = rest_turn[p] @ parent_at[j] + rest_at[p]
        joint = out_turn[p] @ (factor * parent_at[j]) + out_at[p]
        before = turns[p][0]
        children = [t.children[k] for k in range(len(t.joints)) if t.parents[k] == c]
        pin = (joint_model, joint, before)
        turns[c] = _limb_turn(*mine, [c], children, factor, before, joint - factor * before @ joint_model, pin)
        out_turn[c] = turns[c][0] @ rest_turn[c]
        out_at[c] = joint - out_turn[c] @ (factor * child_at[j])
    q = Rotation.from_matrix(out_turn).as_quat(scalar_first=True)
    return q, out_at, factor


# 10 parameters: results of the limbs before this one
def _limb_turn(model, data, limb, trust, own, children, factor, turn, shift, pin=None):
    """A limb's rotation and translation from the rest pose: by its own points, weakly by its children's, held by the
    joint and weakly by the parent's rotation (root: by the whole body's)."""
    mine, theirs = np.isin(limb, own), np.isin(limb, children)
    use = mine | theirs
    m, d = factor * model[use], data[use]
    w = np.where(mine[use], 1.0, 0.15) * trust[use]
    middle = factor * (pin[0] if pin else model.mean(0))
    frame = 0.15 * np.concatenate([np.eye(3), -np.eye(3)]) + middle
    held = frame @ turn.T + shift
    points = np.concatenate([m, frame, middle[None]])
    targets = np.concatenate([d, held, (turn @ middle + shift)[None]])
    weights = np.concatenate([w, np.full(6, 0.02 if pin else 0.1), [8.0 if pin else 0.0]])
    return _robust(points, targets, weights, 0.25)
