"""A body as a chain of limbs with unknown sizes, for fits to named points: places and their derivatives, in NumPy.

By hand, for JAX's were measured (40 markers, 60 frames): 2.9 times as long forwards, 4 times backwards, and 3 seconds
to compile for each number of markers.
"""

import numpy as np
from jaxtyping import Int
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rigid import cross_matrix
from voodoo_jax.kernels.landmarks import named_points
from voodoo_jax.model.body import Body, tree_order


class Chain:
    """A body whose joints hold exactly, with unknown sizes: places of joints and markers as functions of one vector
    (scale, factors of the limbs, shifts of the joints, shifts of the markers) and of the limbs' turns."""

    def __init__(self, body: Body, rows: Int[np.ndarray, " marker"]):
        t = body.topology
        limbs, places = (np.asarray(x) for x in named_points(body))
        self.names, self.joints, self.count = t.limbs, t.joints, body.limb_count
        self.parents, self.children, self.limb = np.array(t.parents, int), np.array(t.children, int), limbs[rows]
        # joints on parents, joints on children, markers; each with its limb
        anchors = (body.parent_anchor, body.child_anchor)
        at = [*(np.asarray(a.translation) for a in anchors), places[rows]]
        self.at = np.concatenate([a.reshape(-1, 3) for a in at]).astype(np.float64)
        self.owner = np.concatenate([self.parents, self.children, self.limb])
        self.frames = [Rotation.from_quat(np.asarray(a.rotation), scalar_first=True).as_matrix() for a in anchors]
        path = np.zeros((self.count, len(t.joints)))
        for j in tree_order(t):
            path[t.children[j]] = path[t.parents[j]]
            path[t.children[j], j] = 1
        # a point of a limb (rows: markers, then origins of limbs) is a sum of places, each turned by its limb
        own = np.zeros((len(self.limb) + self.count, len(self.limb)))
        own[: len(self.limb)] = np.eye(len(self.limb))
        path = path[np.concatenate([self.limb, np.arange(self.count)])]
        self.sum = np.concatenate([path, -path, own], 1)
        self.turned_by = np.eye(self.count)[self.owner]
        shifted = np.concatenate([np.arange(len(t.joints)), np.full(len(t.joints), -1), np.arange(len(self.limb))])
        shifted[-len(self.limb) :] += len(t.joints)
        self.unknowns = 1 + 3 * (self.count + len(t.joints) + len(self.limb))
        self.shifts = np.zeros((len(self.at), 3, self.unknowns))
        for k in np.flatnonzero(shifted >= 0):
            self.shifts[k, :, 1 + 3 * (self.count + shifted[k]) + np.arange(3)] = np.eye(3)
        a, b = (np.asarray(body.axes)[:, k, None] > 0 for k in (0, 1))
        # usual joint angles, radians: hinges hardly leave their plane, universal joints seldom twist
        usual = np.where(a & b, 0.6, [1.2, 1.5, 0.4])
        usual = np.where(b & ~a, [0.2, 2.0, 0.5], np.where(a & ~b, [2.0, 0.2, 0.5], usual))
        self.usual = usual.reshape(-1, 3)

    def _sizes(self, x: np.ndarray) -> np.ndarray:
        return self.at * np.exp(x[0] + x[1 : 1 + 3 * self.count].reshape(-1, 3))[self.owner]

    def sized(self, x: np.ndarray) -> np.ndarray:
        """Places of joints on parents, on children and of markers, metres."""
        return self._sizes(x) + self.shifts @ x

    def sized_by(self, x: np.ndarray) -> np.ndarray:
        """Derivative of `sized` by x."""
        grown, rows = self._sizes(x), np.arange(len(self.at))
        slope = self.shifts.copy()
        slope[:, :, 0] = grown
        for k in range(3):
            slope[rows, k, 1 + 3 * self.owner + k] = grown[:, k]
        return slope

    def points(self, places: np.ndarray, turn: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Positions of markers, then origins of limbs [frame, ., 3], metres."""
        turned = np.einsum("flij,lj->fli", turn[:, self.owner], places)
        return root[:, None] + np.einsum("ml,fli->fmi", self.sum, turned)

    def slopes(self, places, slope, turn) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the markers by the poses (shift of the root, turn of each limb) and by x."""
        n = len(self.limb)
        lever = np.einsum("mk,ki,kl->mli", self.sum[:n], places, self.turned_by)
        by_turn = -np.einsum("flij,mljk->fmilk", turn, cross_matrix(lever)).reshape(len(turn), n, 3, -1)
        by_root = np.broadcast_to(np.eye(3), (len(turn), n, 3, 3))
        by_x = np.einsum("mk,fkip->fmip", self.sum[:n], turn[:, self.owner] @ slope)
        return np.concatenate([by_root, by_turn], -1), by_x

    def angles(self, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles over their usual size [frame, joint, 3], and their derivative by the poses."""
        of_parent, of_child = turn[:, self.parents] @ self.frames[0], turn[:, self.children] @ self.frames[1]
        between = of_parent.swapaxes(-1, -2) @ of_child
        angle = Rotation.from_matrix(between.reshape(-1, 3, 3)).as_rotvec().reshape(*between.shape[:2], 3)
        size = np.maximum(np.linalg.norm(angle, axis=-1), 1e-4)[..., None, None]
        cross = cross_matrix(angle)
        bend = 1 / size**2 - (1 + np.cos(size)) / (2 * size * np.maximum(np.sin(size), 1e-3))
        inverse = np.eye(3) + cross / 2 + bend * cross @ cross
        by_child = inverse @ self.frames[1].swapaxes(-1, -2)
        by_parent = -inverse @ between.swapaxes(-1, -2) @ self.frames[0].swapaxes(-1, -2)
        out = np.zeros((*angle.shape, self.count + 1, 3))
        rows = np.arange(angle.shape[1])
        out[:, rows, :, 1 + self.children] += by_child.swapaxes(0, 1)
        out[:, rows, :, 1 + self.parents] += by_parent.swapaxes(0, 1)
        return angle / self.usual, out.reshape(*angle.shape, -1) / self.usual[..., None]
