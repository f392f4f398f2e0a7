"""A person's sizes and marker places, from the markers alone: one least-squares fit over some frames.

Unknown are the pose of every frame, the scale, three factors per limb and the place of every joint and marker on its
limb; a marker has its site, a joint its place in the body file and a limb its proportion as prior. Gauss-Newton on the
host; the poses of the frames are eliminated from the normal equations (Schur complement).
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.robust import geman_mcclure_root
from voodoo_jax.kernels.landmarks import named_points
from voodoo_jax.markers.first_pose import first_poses
from voodoo_jax.markers.priors import NOISE, SCALE, Chain, Priors
from voodoo_jax.model.body import Body, with_rest_from_joints
from voodoo_jax.model.marker_sets import V1_NAMES

REACH = (0.3, 0.15, 0.06)  # metres at which a marker counts a quarter, from the first steps to the last
STEPS = 15  # at most, for each of them
UNSURE = 0.1  # set by hand: weight in the first pose of a marker of which hardly more than its limb is known
FARTHEST = 0.2  # set by hand: metres from the limb's middle: nobody's markers are farther


class Markers(NamedTuple):
    """Named points of some frames in one order."""

    names: tuple[str, ...]  # as the log calls them
    rows: Int[np.ndarray, " marker"]  # of kernels.landmarks.named_points
    points: Float[np.ndarray, "frame marker 3"]  # world frame, metres; any number where not seen
    seen: Bool[np.ndarray, "frame marker"]
    places: tuple[str, ...] = ()  # of each, as in model.marker_names; (): the points of the body that the rows are
    newington: bool = True  # whether hips are where Plug-in Gait has them, see model.marker_names.Known


class Fit(NamedTuple):
    """Result of fit_markers."""

    scale: float  # of the body
    factors: Float[np.ndarray, "limb 3"]  # of each limb's lengths along its axes, beside the scale
    on_parent: Float[np.ndarray, "joint 3"]  # metres
    on_child: Float[np.ndarray, "joint 3"]
    places: Float[np.ndarray, "marker 3"]  # in the frame of the marker's limb, metres
    rotation: Float[np.ndarray, "frame limb 4"]  # wxyz
    translation: Float[np.ndarray, "frame limb 3"]  # metres
    shifts: Float[np.ndarray, " marker"]  # how far from its site a marker is, or jumps, over what is usual
    cost: float


def fit_markers(body: Body, markers: Markers, sizes: bool = True, scale_known: bool = False) -> Fit:
    """Poses of a body in some frames, and its sizes, from named points; needs no first poses.

    **Arguments:** `markers` at least three seen in each frame; `sizes` False: the body's stay; `scale_known` the body's
    scale stays, proportions are found.
    """
    chain, topology = Chain(body, markers.rows), body.topology
    names = (*topology.sites, *topology.centres)
    spots = markers.places or tuple(names[r] for r in markers.rows)
    priors = Priors(chain, body, spots, 1e-4 if scale_known else SCALE, markers.newington)
    factor = 1.0 if scale_known or not sizes else None
    middle = np.median(markers.points[markers.seen], 0)
    seen = markers.seen
    points = np.where(seen[..., None], markers.points - middle, 0.0).astype(np.float64)
    loose = priors.loose if sizes else np.zeros(len(priors.loose), bool)
    x, turn, root = _start(body, chain, markers._replace(points=points), factor, loose)

    def off(x, turn, root):
        return chain.points(chain.sized(x), turn, root)[:, : points.shape[1]] - points

    def cost(x, turn, root, reach):
        e2 = np.sum(off(x, turn, root) ** 2, -1) / reach**2
        angles = chain.angles(turn)[0]
        usual = (angles**2).sum() / len(turn) + (priors.at(x) ** 2).sum()
        return (seen * e2 / (1 + e2)).sum() * (reach / NOISE) ** 2 + usual

    for reach in REACH:
        now, damping = cost(x, turn, root, reach), 1e-4
        for _ in range(STEPS):
            motion, step = _step(chain, priors, x, turn, off(x, turn, root), seen, reach, damping, sizes)
            spun = turn @ Rotation.from_rotvec(motion[:, 3:].reshape(-1, 3)).as_matrix().reshape(turn.shape)
            after = cost(x + step, spun, root + motion[:, :3], reach)
            if after >= now:
                damping = max(damping, 1e-3) * 10
                continue
            x, turn, root, gain, now = x + step, spun, root + motion[:, :3], now - after, after
            damping = damping / 5
            if gain < 1e-4 * now:
                break
    places = chain.sized(x)
    joints = len(topology.joints)
    at = chain.points(places, turn, root)[:, points.shape[1] :] + middle
    q = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(*turn.shape[:2], 4)
    factors = np.exp(x[1 : 1 + 3 * chain.count]).reshape(-1, 3)
    scale = float(body.scale * np.exp(x[0]))
    shifts = priors.shifts(x)
    # not held by the others: as odd as one at the end of its reach
    away = (seen & (np.linalg.norm(off(x, turn, root), axis=-1) > REACH[-1])).sum(0) / np.maximum(seen.sum(0), 1)
    shifts = np.where(away > 0.3, np.inf, shifts)
    own = places[:joints], places[joints : 2 * joints], places[2 * joints :]
    return Fit(scale, factors, *own, q, at, shifts, float(now))


def _start(body: Body, chain: Chain, markers: Markers, factor: float | None, loose: np.ndarray):
    """First values of the unknowns, the limbs' rotations and the root's places. First poses from the other markers give
    the places of `loose` markers, which then help to find better poses."""
    rows, points, seen = markers.rows, markers.points, markers.seen
    turn, at, scales = first_poses(body, rows, points, seen, factor, np.where(loose, UNSURE, 1.0))
    x, scale = np.zeros(chain.unknowns), float(np.median(scales))
    x[0] = np.log(scale)
    if loose.any():
        shifts = _found_places(chain, x, loose, turn, at, points, seen)
        x[-shifts.size :] = shifts.ravel()
        sites = np.array(body.sites)
        sites[rows[loose]] += shifts[loose] / scale
        found = eqx.tree_at(lambda b: b.sites, body, jnp.asarray(sites))
        turn, at, _ = first_poses(found, rows, points, seen, scale)
    return x, turn, at[:, 0]


# 7 parameters: the state of the fit
def _found_places(chain: Chain, x, loose, turn, origins, points, seen) -> np.ndarray:
    """Shifts of the markers with unknown places to where they are on their limbs in the first poses: in those nearest
    to rest, because the twist of a bent limb is known by such markers only."""
    shifts = np.zeros((len(loose), 3))
    at = chain.sized(x)[-len(loose) :]
    bent = (chain.angles(turn)[0] ** 2).sum((1, 2))
    for m in np.flatnonzero(loose & seen.any(0)):
        limb, use = chain.limb[m], np.flatnonzero(seen[:, m])
        use = use[np.argsort(bent[use])][: max(3, len(use) // 3)]
        local = np.einsum("fji,fj->fi", turn[use, limb], points[use, m] - origins[use, limb])
        shifts[m] = np.clip(np.median(local, 0) - at[m], -FARTHEST, FARTHEST)
    return shifts


# 9 parameters: the state of the fit
def _step(chain: Chain, priors: Priors, x, turn, off, seen, reach: float, damping: float, sizes: bool):
    """One damped Gauss-Newton step: motions of all poses and the change of x (none without `sizes`)."""
    frames = len(turn)
    robust = seen * geman_mcclure_root(np.sum(off**2, -1), reach) / NOISE
    by_pose, by_x = chain.slopes(x, turn)
    by_pose, by_x = ((robust[..., None, None] * j).reshape(frames, -1, j.shape[-1]) for j in (by_pose, by_x))
    r = (robust[..., None] * off).reshape(frames, -1)
    # the joints' angles count once, not once per frame: frames are not independent of each other
    angles, by_turn = (a / np.sqrt(frames) for a in chain.angles(turn))
    angles, by_turn = angles.reshape(frames, -1), by_turn.reshape(frames, -1, by_turn.shape[-1])
    h = by_pose.swapaxes(1, 2) @ by_pose + by_turn.swapaxes(1, 2) @ by_turn
    g = (r[:, None] @ by_pose + angles[:, None] @ by_turn)[:, 0]
    h = h + (damping * np.einsum("fii->fi", h) + 1e-6)[..., None] * np.eye(h.shape[1])
    if not sizes:
        return -np.linalg.solve(h, g[..., None])[..., 0], np.zeros_like(x)
    mixed = by_pose.swapaxes(1, 2) @ by_x
    solved = np.linalg.solve(h, np.concatenate([g[..., None], mixed], 2))
    known, by_known = priors.at(x), priors.slope(x)
    over = lambda a, b: a.reshape(-1, len(x)).T @ b.reshape(frames * a.shape[1], -1)  # noqa: E731  of all frames
    hx = over(by_x, by_x) + by_known.T @ by_known
    gx = over(by_x, r)[:, 0] + by_known.T @ known
    away = over(mixed, solved)
    left = hx + np.diag(damping * np.diag(hx)) - away[:, 1:]
    step = np.linalg.solve(left, away[:, 0] - gx)
    return -solved[:, :, 0] - solved[:, :, 1:] @ step, step


def personal(body: Body, markers: Markers, fit: Fit) -> Body:
    """The body with the sizes, joints and marker places of a fit.

    Reported joint centres that the body has a joint for (same name, or that of H-Anim v1) lie in the joint; other sites
    and centres keep their place in proportion.
    """
    t = body.topology
    grown = fit.factors * fit.scale / float(body.scale)
    limbs_of = np.asarray(named_points(body)[0])
    of_limb = lambda points, limb: np.asarray(points) * grown[np.asarray(limb, int)]  # noqa: E731
    sites, centres = of_limb(body.sites, t.site_limbs), of_limb(body.centres, t.centre_limbs)
    # where several names share a point, the last one holds
    spots = markers.places or ("",) * len(markers.rows)
    for row, spot, place in zip(markers.rows, spots, fit.places):
        if row < len(sites):
            sites[row] = place
        if spot in t.sites:  # not loosely: the body's own point of this name is there, too
            sites[t.sites.index(spot)] = place
    for j, joint in enumerate(t.joints):
        name = V1_NAMES.get(joint, joint)
        if name in t.centres:
            k = t.centres.index(name)
            owner = t.centre_limbs[k]
            if owner in (t.parents[j], t.children[j]):
                centres[k] = (fit.on_parent if owner == t.parents[j] else fit.on_child)[j]
    for row, spot, place in zip(markers.rows, spots, fit.places):
        # a key point that is a joint says itself where that is
        if spot in t.centres and limbs_of[row] == t.centre_limbs[t.centres.index(spot)]:
            centres[t.centres.index(spot)] = place
    at = np.asarray(body.rest.translation) * fit.scale / float(body.scale)
    array = lambda x: jnp.asarray(x, jnp.float32)  # noqa: E731
    new = (
        np.asarray(body.sizes) * grown[:, [0, 1, 0, 1, 2]], at, fit.on_parent, fit.on_child,
        np.asarray(body.axes) * fit.scale / float(body.scale), centres, sites, fit.scale,
    )  # fmt: skip
    where = lambda b: (  # noqa: E731
        b.sizes, b.rest.translation, b.parent_anchor.translation, b.child_anchor.translation, b.axes, b.centres,
        b.sites, b.scale,
    )  # fmt: skip
    return with_rest_from_joints(eqx.tree_at(where, body, tuple(array(x) for x in new)))
