"""The limbs of a body in the bind pose as one mesh, each vertex on one bone, for glTF and USD."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from voodoo_jax.exporters.limb_shapes import loft, profile, side_of
from voodoo_jax.exporters.skeleton import Skeleton
from voodoo_jax.model.body import Body

SIDES = ("middle", "left", "right")
# red, green, blue, 0..1 (linear): left warm, right cool, so that sides are told apart
SIDE_COLOURS = {"middle": (0.55, 0.55, 0.55), "left": (0.85, 0.25, 0.12), "right": (0.10, 0.30, 0.80)}


@dataclass(frozen=True, eq=False)
class LimbMesh:
    """All limbs of one side, metres, in the bind pose and the axes of the skeleton."""

    side: str
    vertices: Float[np.ndarray, "vertex 3"]
    normals: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    bones: Int[np.ndarray, " vertex"]  # bone that moves the vertex


def limb_meshes(body: Body, bones: Skeleton) -> list[LimbMesh]:
    """One mesh for each side that the body has."""
    turn, place = bones.bind_limbs
    parts: dict[str, list] = {side: [] for side in SIDES}
    for limb, name in enumerate(body.topology.limbs):
        points, faces = loft(profile(body, limb))
        corners = points[faces]  # faces do not share vertices: edges of the ends are sharp
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        there = np.linalg.norm(normals, axis=1) > 0.5  # at the end of a round limb faces have no area
        vertices, smooth = corners[there].reshape(-1, 3), np.repeat(normals[there], 3, 0)
        parts[side_of(name)].append(
            (turn[limb].apply(vertices) + place[limb], turn[limb].apply(smooth), bones.main[limb])
        )
    found = []
    for side, pieces in parts.items():
        if pieces:
            vertices, normals = (np.concatenate([piece[k] for piece in pieces]) for k in (0, 1))
            owner = np.concatenate([np.full(len(piece[0]), piece[2]) for piece in pieces])
            found.append(LimbMesh(side, vertices, normals, np.arange(len(vertices)).reshape(-1, 3), owner))
    return found
