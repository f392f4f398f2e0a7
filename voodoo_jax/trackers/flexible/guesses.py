"""The body in single frames by the learned eye: lost hypotheses of the flexible tracker restart from it.

Host side.
"""

import numpy as np
from jaxtyping import Float

from voodoo_jax.geometry.plane import Plane
from voodoo_jax.kernels.eye import JOINTS
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.trackers.flexible.flexible_body import CENTRES, POINTS
from voodoo_jax.trackers.flexible.scores import COUNTS, Guess
from voodoo_jax.trackers.shared.eye import SURE, seen

# concentration of the change of facing between frames (von Mises): chosen on half of experiments/stereo
_STEADY = 6.0
_AT = {name: i for i, name in enumerate(POINTS)}
_NAMED = [_AT[point] for point in CENTRES]
_FROM = [JOINTS.index(centre) for centre in CENTRES.values()]


class Guesses:
    """The body in each frame so far; metres, fixed frame. Left and right are the likeliest by all frames so far, since
    the eye confuses front and back in one of ten frames.

    **Arguments:** `rest` the flexible body at rest.
    """

    def __init__(self, rest: Float[np.ndarray, "16 3"]):
        self.place: dict[int, Guess] = {}  # by row; absent: the eye is not sure
        hip, waist, shoulder = (float(rest[_AT[f"l_{name}"], 2]) for name in ("hip", "waist", "shoulder"))
        self._waist = (waist - hip) / (shoulder - hip)
        self._odds, self._front = 0.0, np.zeros(3)  # in the last frame: odds of the eye's left and right; its front

    def look(self, row: int, person: BodyObservation, floor: Plane) -> None:
        """Adds the next frame."""
        found = seen(person, floor)
        if found is None or np.median(found.spread) > SURE:
            self._front = np.zeros(3)
            return
        odds = float(np.linalg.norm(found.front))
        front = found.front / max(odds, 1e-6)
        alike, before = _STEADY * float(front @ self._front), self._odds
        self._odds = COUNTS * odds + float(
            np.logaddexp(before + alike, -alike) - np.logaddexp(before - alike, alike)
        )  # a step of the forward algorithm for two states
        self._front = front
        found = found if self._odds >= 0 else found.exchanged
        x, error = np.zeros((len(POINTS), 3), np.float32), np.full(len(POINTS), np.inf, np.float32)
        x[_NAMED], error[_NAMED] = found.joints[_FROM], found.spread[_FROM]
        for side in "lr":
            hip, shoulder = x[_AT[f"{side}_hip"]], x[_AT[f"{side}_shoulder"]]
            x[_AT[f"{side}_waist"]] = hip + self._waist * (shoulder - hip)
        self.place[row] = Guess(x, error, np.float32(abs(self._odds)))
