"""Priors for a fit to markers: usual deviations of sizes, joints and markers from the body file."""

from collections.abc import Sequence

import numpy as np

from voodoo_jax.markers.chain import Chain
from voodoo_jax.model.body import Body, segment_lengths
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
JOINT = 0.005  # metres: a joint's place on its limb
GIRDLE = 0.03  # metres: a joint that rides on a girdle of its own, as the shoulder does
HIP = 0.004  # metres: a hip's place by the regression
NEAR_SPINES = 0.015  # set by hand: metres: the same by markers that are only near the pelvis' spines
MIDDLE = 0.004  # set by hand: metres: a joint's centre in the middle between markers on both of its sides
AT_JOINT = 0.006  # set by hand: metres: a joint's centre at a key point that stands for it
PAIRED = 0.01  # set by hand: metres: a joint's place on its limb, where such a middle tells it
LOOSE = 0.04  # set by hand: metres: a marker that may lie off its place by so much is first looked for
ON_LIMB = (0.08, 0.08, 0.15)  # set by hand: metres along the limb's axes: a marker of which only the limb is known
SPINES = (("l_asis",), ("r_asis",), ("l_psis", "mid_psis"), ("r_psis", "mid_psis"))


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
            usual[shift(joint)] = PAIRED
        spines = [next((near.index(s) for s in some if s in near), None) for some in SPINES]
        exact = all(s is not None and sites[s] for s in spines)
        self.hip, self.newington = HIP if exact else NEAR_SPINES, newington
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
                    found.append((pair, joints.index(side + joint), MIDDLE))
        centre_of = {V1_NAMES.get(joint, joint): k for k, joint in enumerate(joints)}
        for centre in topology.centres:
            mine = [m for m, p in enumerate(places) if split_place(p)[0] == centre]
            if mine and centre in centre_of:
                metres = split_place(places[mine[0]])[1] or AT_JOINT
                found.append((mine, centre_of[centre], 2 * MIDDLE if len(mine) > 1 else metres))
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
