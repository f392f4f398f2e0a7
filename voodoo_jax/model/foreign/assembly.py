"""A body from surfaces that are connected by joints."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from voodoo_jax.model.body_text import TextOfBody
from voodoo_jax.model.checked_toml import BodyFileError
from voodoo_jax.model.foreign.frustum_fit import Frustum, fit_frustum

ROUGH = 0.01  # metres of a surface from its frustum that are worth a note
LEVER = 0.02  # metres: hinges are held at least so far to both sides
STRAIGHT = 0.99  # cosine: axes that are nearer to a direction do not tell what is across
HALF_TURN = 180.0  # degrees: limits beyond say nothing


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
