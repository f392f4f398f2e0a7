"""A body from surfaces that are connected by joints: each limb the tapered elliptic cylinder nearest to its surface."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from voodoo_jax.model.body_file import TextOfBody
from voodoo_jax.model.checked_toml import BodyFileError

SIDE = 0.7  # cosine of 45 degrees: faces that look along the axis by more are ends
FEW = 30  # points on the sides below which all are taken for sides
THIN = 0.003  # metres: no semi-axis is smaller
OUTLIERS = 0.01  # metres from which a point counts less (soft L1): handles, screws, cables
PREFERRED = 0.8  # what a named direction's distance counts: of two that fit alike the joints' own is taken
ROUGH = 0.01  # metres of a surface from its frustum that are worth a note
LEVER = 0.02  # metres: hinges are held at least so far to both sides
STRAIGHT = 0.99  # cosine: axes that are nearer to a direction do not tell what is across
HALF_TURN = 180.0  # degrees: limits beyond say nothing


class Frustum(NamedTuple):
    """Centres of both end ellipses, directions and sizes of their axes, and the distance of the surface; metres."""

    bottom: Float[np.ndarray, "3"]
    top: Float[np.ndarray, "3"]
    x_axis: Float[np.ndarray, "3"]
    bottom_axes: Float[np.ndarray, "2"]
    top_axes: Float[np.ndarray, "2"]
    off: float  # root mean square


def fit_frustum(
    points: Float[np.ndarray, "point 3"], normals: Float[np.ndarray, "point 3"], hints: Iterable[np.ndarray] = ()
) -> Frustum:
    """The frustum nearest to points that are evenly spread over a surface, along one of its principal directions or of
    `hints`, such as the line between two joints."""
    own = np.linalg.svd(points - points.mean(0), full_matrices=False)[2]
    named = [hint / np.linalg.norm(hint) for hint in hints if np.linalg.norm(hint) > THIN]
    found = [(PREFERRED, _along(points, normals, axis)) for axis in named]
    found += [(1.0, _along(points, normals, axis)) for axis in own]
    return min(found, key=lambda one: one[0] * one[1].off)[1]


def _along(points: np.ndarray, normals: np.ndarray, z: np.ndarray) -> Frustum:
    """Ends at the extremes along z; centres and axes of both ellipses by least squares on the sides."""
    along = points @ z
    low, high = float(along.min()), max(float(along.max()), float(along.min()) + 2 * THIN)
    across = points - np.outer(along, z)
    middle = across.mean(0)
    x = np.linalg.svd(across - middle, full_matrices=False)[2][0]
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    flat = np.stack([(across - middle) @ x, (across - middle) @ y], 1)
    share = (along - low) / (high - low)
    side = np.abs(normals @ z) < SIDE
    side = side if side.sum() >= FEW else np.ones(len(points), bool)
    # points on an ellipse have half of its squared semi-axis as mean square
    first = np.log(np.maximum(np.sqrt(2) * flat[side].std(0), THIN))
    start = np.concatenate([np.zeros(4), first, first])

    def gaps(p: np.ndarray, of: np.ndarray = side) -> np.ndarray:
        s = share[of][:, None]
        centre, axes = p[:2] + (p[2:4] - p[:2]) * s, _between(p, s)
        return (np.linalg.norm((flat[of] - centre) / axes, axis=1) - 1) * axes.mean(1)

    p = least_squares(gaps, start, loss="soft_l1", f_scale=OUTLIERS).x
    ends = np.minimum(along - low, high - along)[~side]
    off = float(np.sqrt(np.mean(np.concatenate([gaps(p), ends]) ** 2)))
    at = lambda centre, height: middle + centre[0] * x + centre[1] * y + height * z  # noqa: E731
    return Frustum(at(p[:2], low), at(p[2:4], high), x, np.exp(p[4:6]), np.exp(p[6:8]), off)


def _between(p: np.ndarray, share: np.ndarray) -> np.ndarray:
    first, last = np.maximum(np.exp(p[4:6]), THIN), np.maximum(np.exp(p[6:8]), THIN)
    return first + (last - first) * share


@dataclass(frozen=True)
class Piece:
    """A rigid part: its surface and its joint to the parent, in the rest pose; z up, metres."""

    name: str
    parent: int  # number of the piece that it hangs on, -1: the root
    points: Float[np.ndarray, "point 3"]
    normals: Float[np.ndarray, "point 3"]
    joint: str = ""
    at: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))  # of the joint
    axis: Float[np.ndarray, "3"] | None = None  # of a hinge; None: it turns freely
    limits: tuple[float, float] | None = None  # degrees from the rest pose

    def with_surface(self, points: Float[np.ndarray, "more 3"], normals: Float[np.ndarray, "more 3"]) -> "Piece":
        """The piece with a further part of its surface."""
        both = np.concatenate([self.points, points]), np.concatenate([self.normals, normals])
        return replace(self, points=both[0], normals=both[1])


def assembled(pieces: list[Piece], name: str, scale_name: str, source: str) -> tuple[str, list[str]]:
    """The body's file, standing on the floor in its rest pose, and notes on parts that do not fit well.

    Joints become joint centres of the same names, and each limb that nothing hangs on has a centre at its end, named as
    it with `_tip`. Raises BodyFileError.
    """
    limbs = [_limb(pieces, i) for i in range(len(pieces))]
    ground = min(float(piece.points[:, 2].min()) for piece in pieces)
    scale = _reach(pieces, limbs)
    if not scale > 0:
        raise BodyFileError(source, None, "it has no extent")
    text = TextOfBody(scale, np.array([0, 0, ground]))
    text.head(name, scale_name)
    for piece, limb in zip(pieces, limbs):
        text.limb(piece.name, limb.bottom, limb.top, limb.x_axis, limb.bottom_axes, limb.top_axes)
    for i, piece in enumerate(pieces):
        if piece.parent >= 0:
            text.joint(piece.joint, pieces[piece.parent].name, piece.name, at=piece.at, **_held(piece, limbs, i))
    for i, piece in enumerate(pieces):
        if piece.parent >= 0:
            text.point("centre", piece.joint, piece.name, piece.at)
        hanging = [p for p in pieces if p.parent == i]
        if not hanging:
            text.point("centre", f"{piece.name}_tip", piece.name, limbs[i].top)
        if piece.parent >= 0 and len(hanging) < 2:
            text.segment(piece.name, piece.joint, hanging[0].joint if hanging else f"{piece.name}_tip")
    notes = [
        f"'{p.name}' differs from its cylinder by {100 * limb.off:.1f} cm (root mean square)"
        for p, limb in zip(pieces, limbs)
        if limb.off > ROUGH
    ]
    return text.text(), notes


def _limb(pieces: list[Piece], i: int) -> Frustum:
    """The frustum of a piece, its bottom at the end that is nearer to its joint (the root's: nearer to the floor)."""
    piece = pieces[i]
    hanging = [p.at for p in pieces if p.parent == i]
    hints = [at - piece.at for at in hanging] if piece.parent >= 0 else [np.array([0.0, 0, 1])]
    found = fit_frustum(piece.points, piece.normals, hints)
    if piece.parent >= 0:
        turned = np.linalg.norm(found.top - piece.at) < np.linalg.norm(found.bottom - piece.at)
    else:
        turned = found.top[2] < found.bottom[2]
    if turned:
        return Frustum(found.top, found.bottom, found.x_axis, found.top_axes, found.bottom_axes, found.off)
    return found


def _reach(pieces: list[Piece], limbs: list[Frustum]) -> float:
    """Length of the longest chain from the root's bottom to an end, metres."""

    def to_end(i: int, start: np.ndarray) -> float:
        ends = [float(np.linalg.norm(p.at - start)) + to_end(k, p.at) for k, p in enumerate(pieces) if p.parent == i]
        return max(ends, default=float(np.linalg.norm(limbs[i].top - start)))

    return to_end(0, limbs[0].bottom)


def _held(piece: Piece, limbs: list[Frustum], i: int) -> dict:
    """Ellipse, frame and limits of a joint (Knoop 2007, sec. 4.2): one semi-axis along a hinge's axis, else none."""
    if piece.axis is None:
        return {"axes": np.zeros(2)}
    y = piece.axis / np.linalg.norm(piece.axis)
    z = limbs[i].top - limbs[i].bottom
    z = z / np.linalg.norm(z)
    if abs(y @ z) > STRAIGHT:  # it rolls about its own length
        z = limbs[i].x_axis
    z = z - y * (y @ z)
    z /= np.linalg.norm(z)
    lever = max(LEVER, float(np.mean([limbs[i].bottom_axes, limbs[piece.parent].top_axes])))
    held = {"axes": np.array([0.0, lever]), "x_axis": np.cross(y, z), "z_axis": z}
    if piece.limits is not None and max(map(abs, piece.limits)) <= HALF_TURN:
        held["swing_y"] = np.array(piece.limits)
    return held
