"""Shapes of limbs in drawings: the tracked cylinders, and a round head on a neck."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.model.body import Body
from voodoo_jax.records.tracks import Tracks

RING = 32  # points on each ellipse of an outline
NECK = 0.7  # of the head's least semi-axis: the neck's; by eye
# height on the head, shares of its length, and the share of its semi-axes there: chin, cheeks, a dome; by eye
ROUND = ((0.0, 0.75), (0.12, 0.9), (0.3, 1.0), (0.6, 1.0), (0.75, 0.92), (0.87, 0.74), (0.95, 0.48), (1.0, 0.0))


def side_of(limb: str) -> str:
    """Left, right or middle, by the beginning of a limb's name."""
    return "left" if limb.startswith("l_") else "right" if limb.startswith("r_") else "middle"


def profile(body: Body, limb: int) -> Float[np.ndarray, "ring 3"]:
    """Ellipses along a limb's axis, from the bottom to the top: height, semi-axes along x and y, metres."""
    t, sizes = body.topology, np.asarray(body.sizes, float)
    a0, b0, a1, b1, length = sizes[limb]
    if t.limbs[limb] != "head" or limb not in t.children:
        return np.array([[0, a0, b0], [length, a1, b1]])
    joint = t.children.index(limb)
    # from where the limb below it ends, straight on through the joint
    above = float(body.parent_anchor.translation[joint, 2]) - sizes[t.parents[joint], 4]
    low, neck = float(body.child_anchor.translation[joint, 2]) - max(0.0, above), NECK * min(a0, b0)
    rings = [[low, neck, neck], [0.0, neck, neck]] if low < 0 else []
    rings += [[s * length, w * (a0 + s * (a1 - a0)), w * (b0 + s * (b1 - b0))] for s, w in ROUND]
    return np.array(rings)


def loft(
    rings: Float[np.ndarray, "ring 3"], sections: int = 24
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Vertices and faces of a closed surface through ellipses as of `profile`: the centres of both ends, then this many
    vertices on each ring."""
    angle = np.linspace(0, 2 * np.pi, sections, endpoint=False)
    round_ = [np.stack([a * np.cos(angle), b * np.sin(angle), np.full(sections, z)], -1) for z, a, b in rings]
    points = np.concatenate([[[0, 0, rings[0][0]], [0, 0, rings[-1][0]]], *round_])
    here = 2 + np.arange(sections)
    after, last = np.roll(here, -1), sections * (len(rings) - 1)
    bottom, top = np.zeros_like(here), np.ones_like(here)
    corners = [(here, bottom, after), (here + last, after + last, top)]
    for k in range(0, last, sections):
        corners += [(here + k, after + k, here + k + sections), (here + k + sections, after + k, after + k + sections)]
    return points, np.stack([np.stack(some, -1) for some in corners], 1).reshape(-1, 3)


def limb_rings(tracks: Tracks, i: int) -> np.ndarray:
    """Points on the ellipses of all limbs [limb, point, 3] in the fixed frame, metres; NaN: not there."""
    return rings(tracks.body, tracks.rotation[i], tracks.translation[i])


def rings(body: Body, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """The same of a body in these poses of its limbs (quaternions wxyz, metres)."""
    shapes = [profile(body, limb) for limb in range(body.limb_count)]
    most = max(map(len, shapes))  # the last ellipse is repeated, so that limbs have as many points
    stacked = np.array([shape[np.minimum(np.arange(most), len(shape) - 1)] for shape in shapes])
    z, a, b = np.moveaxis(stacked, 2, 0)[..., None]
    angle = np.linspace(0, 2 * np.pi, RING, endpoint=False)
    points = np.stack([a * np.cos(angle), b * np.sin(angle), z + 0 * angle], -1).reshape(len(shapes), -1, 3)
    # a limb that is not there stays NaN by its place
    turn = np.where(np.isfinite(rotation), rotation, 1.0).astype(float)
    turn = Rotation.from_quat(turn, scalar_first=True).as_matrix()
    return points @ turn.transpose(0, 2, 1) + translation[:, None]
