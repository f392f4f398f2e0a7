"""Whether a posture is that of a person who faces forwards, or of one tracked back to front. Host side.

People lean forwards, hold hands and head in front of the trunk, and bend elbows backwards and knees forwards. For a
body fitted to a person's back as if it were the front, all of this is reversed, whatever the clothes.
"""

import numpy as np
from jaxtyping import Float32

from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.model.body import Body

# how far ahead, over the distance from hips to shoulders: the middle between those who face ahead and those who were
# tracked turned round, and from there to the mean of either; measured on 30 recordings of experiments/scoreboard and
# experiments/people, in all of which the turned one has less
LEAN = (0.045, 0.144)  # shoulders, of the hips
HANDS = (-0.001, 0.129)  # wrists, of the shoulders
ELBOWS = (0.010, 0.076)  # the middle between shoulder and wrist, of the elbow
KNEES = (0.036, 0.113)  # knees, of the middle between hip and ankle
HEAD = (0.037, 0.049)  # the head's joint, of the neck's
SIDES = ("shoulder", "elbow", "radiocarpal", "hip", "knee", "talocrural")
JOINTS = ("skullbase", "vc7", *(f"{side}_{name}" for side in "lr" for name in SIDES))


def faces_ahead(body: Body, poses: Poses, up: Float32[np.ndarray, "3"]) -> float:
    """Score of a posture: 1 for facing ahead, -1 for turned round; NaN of a body that lacks such joints. The mean over
    the frames, weighted by how upright they are: a lying person leans in any direction.

    **Arguments:** `poses` [frame, limb] on the host; NaN where there are none. `up` in their frame, a unit vector.
    """
    names, there = body.topology.centres, np.isfinite(poses.translation).all((1, 2))
    if not set(JOINTS) <= set(names) or not there.any():
        return float("nan")
    here = poses[there][:, np.array(body.topology.centre_limbs, int)]
    places = np.asarray(apply(here, np.asarray(body.centres)), float)
    at = {name: places[:, names.index(name)] for name in JOINTS}
    middle = {name: (at[f"l_{name}"] + at[f"r_{name}"]) / 2 for name in SIDES}
    left = at["l_hip"] - at["r_hip"] + at["l_shoulder"] - at["r_shoulder"]
    ahead = np.cross(left, up)
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-6)
    trunk = middle["shoulder"] - middle["hip"]
    length = np.linalg.norm(trunk, axis=1)
    upright = np.maximum(trunk @ up / length, 0.0)
    if not upright.any():
        return 0.0
    found = (
        (LEAN, trunk),
        (HANDS, middle["radiocarpal"] - middle["shoulder"]),
        (ELBOWS, (middle["shoulder"] + middle["radiocarpal"]) / 2 - middle["elbow"]),
        (KNEES, middle["knee"] - (middle["hip"] + middle["talocrural"]) / 2),
        (HEAD, at["skullbase"] - at["vc7"]),
    )
    share = lambda offset: np.average(np.sum(offset * ahead, 1) / length, weights=upright)  # noqa: E731
    return float(upright.mean() * np.mean([np.clip((share(x) - m) / s, -1, 1) for (m, s), x in found]))
