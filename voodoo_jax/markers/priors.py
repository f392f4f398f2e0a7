"""What a usual person is like: how far sizes, joints and markers may be from the body file in a fit to markers."""

import numpy as np

from voodoo_jax.markers.chain import Chain
from voodoo_jax.model.body import Body, segment_lengths
from voodoo_jax.model.marker_sets import RIDES, USUAL_LENGTHS, newington_hips, placement

SCALE, ACROSS, ALONG = 0.5, 0.1, 0.06  # usual deviations (logarithms) of the scale, a limb's thickness and its length
MIRRORED = 0.02  # between left and right limbs
JOINT = 0.005  # metres: a joint's place on its limb
GIRDLE = 0.03  # metres: a joint that rides on a girdle of its own, as the shoulder does
HIP = 0.004  # metres: a hip's place by the regression
SPINES = (("l_asis",), ("r_asis",), ("l_psis", "mid_psis"), ("r_psis", "mid_psis"))


class Priors:
    """Deviations of the unknowns of a chain from a usual person over their usual size: `at(x)`, and `slope(x)`."""

    def __init__(self, chain: Chain, body: Body, sites: list[str], scale: float):
        n, joints = chain.count, list(chain.joints)
        shift = lambda k: slice(1 + 3 * (n + k), 4 + 3 * (n + k))  # noqa: E731  of joints, then of markers
        usual = np.concatenate([[scale], np.tile([ACROSS, ACROSS, ALONG], n), np.full(3 * len(joints), JOINT)])
        usual = np.concatenate([usual, *(placement(s) for s in sites)])
        spines = [next((sites.index(s) for s in some if s in sites), None) for some in SPINES]
        self.hips = [joints.index(h) for h in ("l_hip", "r_hip") if h in joints] if None not in spines else []
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

    def _leg(self, places: np.ndarray, stature: float) -> float:
        """From the front of the pelvis to the ankles of somebody who stands, metres."""
        if not len(self.legs):
            return 0.52 * stature
        hip, above, knee, below, ankle = places[self.legs.T]
        down = places[self.spines[:2], 2] - hip[:, 2]
        return float(np.mean(down + np.linalg.norm(above - knee, axis=1) + np.linalg.norm(below - ankle, axis=1)))

    def at(self, x: np.ndarray) -> np.ndarray:
        """Deviations, each in units of its usual size."""
        out = self.straight @ (x - self.mean)
        if len(self.hips) < 2:
            return out
        places = self.chain.sized(x)
        hips = newington_hips(places[self.spines], self._leg(places, self.stature * float(np.exp(x[0]))))
        return np.concatenate([out, ((places[self.hips] - hips) / HIP).ravel()])

    def shifts(self, x: np.ndarray) -> np.ndarray:
        """How far each marker is from its site, over its usual size: the largest of three axes."""
        return np.abs((self.straight @ (x - self.mean))[self.markers]).reshape(-1, 3).max(1)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Derivative of `at`."""
        if len(self.hips) < 2:
            return self.straight
        here, rows = self.at(x)[-6:], np.zeros((6, len(x)))
        spines = self.chain.sized_by(x)[[*self.spines, *self.hips, *self.legs.ravel()]].any((0, 1))
        for k in np.flatnonzero(spines):
            rows[:, k] = (self.at(x + 1e-6 * np.eye(1, len(x), int(k))[0])[-6:] - here) / 1e-6
        return np.concatenate([self.straight, rows])


def twin(limb: str, limbs: tuple[str, ...]) -> bool:
    """Whether a limb is a left one that has a right one."""
    return limb[:2] == "l_" and "r_" + limb[2:] in limbs
