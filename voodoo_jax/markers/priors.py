"""A body as a chain of limbs with unknown sizes, for fits to named points: places and their derivatives, in NumPy; and
what a usual person is like.

Derivatives are by hand, for JAX's were measured (40 markers, 60 frames): 2.9 times as long forwards, 4 times backwards,
and 3 seconds to compile for each number of markers.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rigid import cross_matrix
from voodoo_jax.kernels.landmarks import named_points
from voodoo_jax.model.body import Body, segment_lengths, tree_order
from voodoo_jax.model.marker_names import split_place
from voodoo_jax.model.marker_sets import (
    MIDDLES,
    RIDES,
    USUAL_LENGTHS,
    V1_NAMES,
    harrington_hips,
    newington_hips,
    placement,
)

SCALE, ACROSS, ALONG = 0.5, 0.1, 0.06  # usual deviations (logarithms) of the scale, a limb's thickness and its length
MIRRORED = 0.02  # between left and right limbs
JOINT = 0.005  # metres: a joint's place on its limb, and its centre at a key point that stands for it; by hand
GIRDLE = 0.03  # metres: a joint that rides on a girdle of its own, as the shoulder does
# metres: a joint's centre by the hips' regression, or midway between markers on both of its sides; by hand
CENTRE = 0.004
NEAR_SPINES = 0.015  # set by hand: metres: the same by markers that are only near the pelvis' spines
# metres: how far a marker moves on its limb with skin and muscle, and so a place midway between two; by hand
NOISE = 0.01
LOOSE = 0.04  # set by hand: metres: a marker that may lie off its place by so much is first looked for
ON_LIMB = (0.08, 0.08, 0.15)  # set by hand: metres along the limb's axes: a marker of which only the limb is known
SPINES = (("l_asis",), ("r_asis",), ("l_psis", "mid_psis"), ("r_psis", "mid_psis"))


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

    def slopes(self, x: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the markers by the poses (shift of the root, turn of each limb) and by x."""
        frames, n, joints = len(turn), len(self.limb), len(self.joints)
        on_limb = lambda places: np.einsum("mk,ki,kl->mli", self.sum[:n], places, self.turned_by)  # noqa: E731
        along = lambda turn: turn.swapaxes(1, 2)[:, None]  # noqa: E731  frame, 1, world axis, limb, limb's axis
        by_root = np.broadcast_to(np.eye(3), (frames, n, 3, 3))
        by_turn = -(turn[:, None] @ cross_matrix(on_limb(self.sized(x)))).swapaxes(2, 3)
        by_factor = along(turn) * on_limb(self._sizes(x))[:, None]
        by_joint = along(turn[:, self.parents]) * self.sum[:n, None, :joints, None]
        by_marker = along(turn[:, self.limb]) * np.eye(n)[:, None, :, None]
        by_x = [by_factor.sum((-2, -1)), by_factor, by_joint, by_marker]
        flat = lambda parts: np.concatenate([p.reshape(frames, n, 3, -1) for p in parts], -1)  # noqa: E731
        return flat([by_root, by_turn]), flat(by_x)

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


class Priors:
    """Deviations of the unknowns of a chain from a usual person over their usual size: `at(x)`, and `slope(x)`."""

    def __init__(self, chain: Chain, body: Body, places: Sequence[str], scale: float, newington: bool = True):
        n, joints = chain.count, list(chain.joints)
        spread = [_spread(place, chain.names) for place in places]
        self.loose = np.array([p in chain.names or (split_place(p)[1] or 0) >= LOOSE for p in places], bool)
        near = [split_place(p)[0] if (split_place(p)[1] or 0) < LOOSE else "" for p in places]
        sites = [p if "~" not in p else "" for p in places]
        shift = lambda k: slice(1 + 3 * (n + k), 4 + 3 * (n + k))  # noqa: E731  of joints, then of markers
        usual = np.concatenate([[scale], np.tile([ACROSS, ACROSS, ALONG], n), np.full(3 * len(joints), JOINT)])
        usual = np.concatenate([usual, *spread])
        self.middles = self._middles(chain, body, places)
        for _, joint, _ in self.middles:
            usual[shift(joint)] = NOISE
        spines = [next((near.index(s) for s in some if s in near), None) for some in SPINES]
        exact = all(s is not None and sites[s] for s in spines)
        self.hip, self.newington = CENTRE if exact else NEAR_SPINES, newington
        self.hips = [joints.index(h) for h in ("l_hip", "r_hip") if h in joints] if None not in spines else []
        settled = {joint for _, joint, _ in self.middles}
        self.hips = [] if settled & set(self.hips) else self.hips  # measured: no regression
        for h in self.hips:
            usual[shift(h)] = 0.1
        self.straight = np.diag(1 / usual)
        for site, joint in RIDES.items():
            if site in sites and joint in joints:
                self.straight[shift(len(joints) + sites.index(site)), shift(joints.index(joint))] = -np.diag(
                    1 / usual[shift(len(joints) + sites.index(site))]
                )
                self.straight[shift(joints.index(joint)), shift(joints.index(joint))] = np.eye(3) / GIRDLE
        pairs = [(i, chain.names.index("r_" + m[2:])) for i, m in enumerate(chain.names) if twin(m, chain.names)]
        for i, k in pairs:
            row = np.zeros((3, chain.unknowns))
            row[:, 1 + 3 * i : 4 + 3 * i], row[:, 1 + 3 * k : 4 + 3 * k] = np.eye(3) / MIRRORED, -np.eye(3) / MIRRORED
            self.straight = np.concatenate([self.straight, row])
        self.mean = np.zeros(chain.unknowns)
        lengths = segment_lengths(body)
        for i, name in enumerate(chain.names):
            part = name.split("_", 1)[-1]
            if part in USUAL_LENGTHS and part in lengths and body.scale_name == "stature":
                self.mean[3 + 3 * i] = np.log(USUAL_LENGTHS[part] * float(body.scale) / lengths[part])
        self.markers = slice(1 + 3 * (n + len(joints)), chain.unknowns)
        self.chain, self.stature = chain, float(body.scale)
        self.spines = [2 * len(joints) + s for s in spines if s is not None]
        down = [[f"{side}_{name}" for name in ("hip", "knee", "ankle")] for side in "lr"]
        # places of hips on the pelvis, of both ends of thighs and of both ends of shanks
        legs = [[joints.index(j) for j in leg] for leg in down if set(leg) <= set(joints)]
        self.legs = np.array([[h, len(joints) + h, k, len(joints) + k, a] for h, k, a in legs], int)

    @staticmethod
    def _middles(chain: Chain, body: Body, places: Sequence[str]) -> list[tuple[list[int], int, float]]:
        """Pairs of markers with a joint's centre in their middle, the joint, and its uncertainty in metres."""
        joints, topology, found = list(chain.joints), body.topology, []
        for joint, ends in MIDDLES.items():
            for side in ("l_", "r_"):
                pair = [places.index(side + end) for end in ends if side + end in places]
                if len(pair) == len(ends) and side + joint in joints:
                    found.append((pair, joints.index(side + joint), CENTRE))
        centre_of = {V1_NAMES.get(joint, joint): k for k, joint in enumerate(joints)}
        for centre in topology.centres:
            mine = [m for m, p in enumerate(places) if split_place(p)[0] == centre]
            if mine and centre in centre_of:
                metres = split_place(places[mine[0]])[1] or JOINT
                found.append((mine, centre_of[centre], 2 * CENTRE if len(mine) > 1 else metres))
        return found

    def _ends(self, places: np.ndarray) -> list[np.ndarray]:
        """Offsets of joints' centres from the middles of their markers, each over its usual size."""
        count, out = len(self.chain.joints), []
        for markers, joint, metres in self.middles:
            owner = self.chain.limb[markers[0]]
            anchor = joint if owner == self.chain.parents[joint] else count + joint
            out.append((places[[2 * count + m for m in markers]].mean(0) - places[anchor]) / metres)
        return out

    def _leg(self, places: np.ndarray, stature: float) -> float:
        """Distance from the front of the pelvis to the ankles of a standing person, metres."""
        if not len(self.legs):
            return 0.52 * stature
        hip, above, knee, below, ankle = places[self.legs.T]
        down = places[self.spines[:2], 2] - hip[:, 2]
        return float(np.mean(down + np.linalg.norm(above - knee, axis=1) + np.linalg.norm(below - ankle, axis=1)))

    def at(self, x: np.ndarray) -> np.ndarray:
        """Deviations, each in units of its usual size."""
        return np.concatenate([self.straight @ (x - self.mean), *self._ends(self.chain.sized(x)), self._hips(x)])

    def _hips(self, x: np.ndarray) -> np.ndarray:
        """Deviations of the hips from the regression."""
        if len(self.hips) < 2:
            return np.zeros(0)
        places = self.chain.sized(x)
        if self.newington:
            hips = newington_hips(places[self.spines], self._leg(places, self.stature * float(np.exp(x[0]))))
        else:
            hips = harrington_hips(places[self.spines])
        return ((places[self.hips] - hips) / self.hip).ravel()

    def shifts(self, x: np.ndarray) -> np.ndarray:
        """Distance of each marker from its site, over its usual size: the largest of three axes."""
        return np.abs((self.straight @ (x - self.mean))[self.markers]).reshape(-1, 3).max(1)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Derivative of `at`."""
        slope = self.chain.sized_by(x)
        ends = [self.straight, *self._ends(slope)]
        if len(self.hips) < 2:
            return np.concatenate(ends)
        here, rows = self._hips(x), np.zeros((6, len(x)))
        for k in np.flatnonzero(slope[[*self.spines, *self.hips, *self.legs.ravel()]].any((0, 1))):
            rows[:, k] = (self._hips(x + 1e-6 * np.eye(1, len(x), int(k))[0]) - here) / 1e-6
        return np.concatenate([*ends, rows])


def _spread(place: str, limbs: tuple[str, ...]) -> tuple[float, float, float]:
    """Standard deviation in metres of a marker at a place, along its limb's axes."""
    point, metres = split_place(place)
    if metres is not None:
        return metres, metres, metres
    return ON_LIMB if point in limbs else placement(point)


def twin(limb: str, limbs: tuple[str, ...]) -> bool:
    """Whether a limb is a left one with a right counterpart."""
    return limb[:2] == "l_" and "r_" + limb[2:] in limbs
