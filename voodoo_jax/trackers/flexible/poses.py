"""Converts the flexible body's points to joint centres and limb poses of tracks. Host side."""

import numpy as np
from jaxtyping import Float, Float32
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rotations import shortest_turns
from voodoo_jax.model.body import Body, joint_centres, without_side
from voodoo_jax.trackers.flexible.flexible_body import CENTRES, POINTS

# offset from a point to the joint centre of its name, in the torso's directions (forward, left for the left side, up)
# and towards the camera, since bodies are thicker or thinner than cylinders: shares of stature, measured on half of the
# rendered stereo recordings (experiments/flexible)
OFFSETS: dict[str, tuple[float, float, float, float]] = {
    "head": (0.001, -0.001, 0.013, 0.009),
    "neck": (-0.005, -0.001, 0.020, 0.008),
    "shoulder": (0.008, -0.003, 0.018, 0.001),
    "elbow": (-0.005, -0.002, 0.009, 0.007),
    "wrist": (0.003, 0.005, 0.001, 0.003),
    "hip": (-0.004, 0.001, 0.008, -0.007),
    "knee": (0.002, 0.003, 0.002, 0.017),
    "ankle": (0.009, -0.006, -0.003, 0.019),
}


def directions(x: Float[np.ndarray, "frame 16 3"], upper: bool) -> Float[np.ndarray, "frame 3 3"]:
    """Directions of the upper or lower torso; rows: forward, left, up."""
    i = {name: n for n, name in enumerate(POINTS)}
    waist = (x[:, i["l_waist"]] + x[:, i["r_waist"]]) / 2
    a, b = (x[:, i[f"{side}_shoulder" if upper else f"{side}_hip"]] for side in "lr")
    up = (a + b) / 2 - waist if upper else waist - (a + b) / 2
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-6)
    left = a - b
    left = left - (left * up).sum(1, keepdims=True) * up
    left = left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-6)
    return np.stack([np.cross(left, up), left, up], 1)


def centres_of(
    body: Body, x: Float[np.ndarray, "frame 16 3"], stature: float, camera: Float[np.ndarray, "frame 3"]
) -> Float32[np.ndarray, "frame centre 3"]:
    """Joint centres `body.topology.centres`, metres; NaN without such a point. `camera` its position, metres."""
    frame = {True: directions(x, True), False: directions(x, False)}
    named = {centre: name for name, centre in CENTRES.items()}
    out = np.full((len(x), len(body.topology.centres), 3), np.nan)
    for n, centre in enumerate(body.topology.centres):
        if centre in named:
            name = named[centre]
            upper = name in ("head", "neck") or name.split("_")[-1] in ("shoulder", "elbow", "wrist")
            *shift, near = np.array(OFFSETS[without_side(name)]) * stature
            shift = np.array(shift) * [1, -1 if name.startswith("r_") else 1, 1]
            at = x[:, POINTS.index(name)]
            toward = camera - at
            toward = toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-6)
            out[:, n] = at + shift @ frame[upper] + near * toward
    return out.astype(np.float32)


def limb_poses(
    body: Body, x: Float[np.ndarray, "frame 16 3"]
) -> tuple[Float32[np.ndarray, "frame limb 4"], Float32[np.ndarray, "frame limb 3"]]:
    """T_fixed_limb of a person's body (scaled to the stature): rotations wxyz and translations, metres.

    The torso's parts turn with its points; each other limb turns with the torso, then by the shortest rotation to its
    axis. The flexible body does not know a limb's rotation about its own axis. NaN for limbs without a known joint.
    """
    frames, t = len(x), body.topology
    upper, lower = (np.swapaxes(directions(x, which), 1, 2) for which in (True, False))  # columns
    rest = np.asarray(joint_centres(body, body.rest), float)
    at = {name: rest[t.centres.index(centre)] for name, centre in CENTRES.items()}
    now = {name: x[:, n] for n, name in enumerate(POINTS)}
    own = Rotation.from_quat(np.asarray(body.rest.rotation, float)[:, [1, 2, 3, 0]])
    place = np.asarray(body.rest.translation, float)
    rotation, translation = np.full((frames, len(t.limbs), 4), np.nan), np.full((frames, len(t.limbs), 3), np.nan)
    spans = _list_spans()
    for limb, name in enumerate(t.limbs):
        if name not in spans:
            continue
        start, end, base, middle = spans[name]
        base = upper if base == "upper" else lower
        turn = base
        if end is not None:
            before = np.einsum("fij,j->fi", base, at[end] - at[start])
            turn = shortest_turns(before, now[end] - now[start]).as_matrix() @ base
        known = [start, end] if middle and end is not None else [start]
        anchor = np.mean([at[n] for n in known], 0)
        centre = np.mean([now[n] for n in known], 0)
        q = (Rotation.from_matrix(turn) * own[limb]).as_quat() if frames else np.zeros((0, 4))
        rotation[:, limb] = q[:, [3, 0, 1, 2]]
        translation[:, limb] = centre + np.einsum("fij,j->fi", turn, place[limb] - anchor)
    return rotation.astype(np.float32), translation.astype(np.float32)


def _list_spans() -> dict[str, tuple[str, str | None, str, bool]]:
    """Limb -> its root point, its end point (None: it turns with the torso), its part of the torso, and whether both
    points place it."""
    out: dict[str, tuple[str, str | None, str, bool]] = {
        "pelvis": ("l_hip", None, "lower", False),
        "chest": ("neck", None, "upper", False),
        "torso": ("neck", None, "upper", False),
        "head": ("neck", "head", "upper", False),
    }
    for side in "lr":
        out[f"{side}_upper_arm"] = f"{side}_shoulder", f"{side}_elbow", "upper", True
        out[f"{side}_forearm"] = f"{side}_elbow", f"{side}_wrist", "upper", True
        out[f"{side}_thigh"] = f"{side}_hip", f"{side}_knee", "lower", True
        out[f"{side}_shank"] = f"{side}_knee", f"{side}_ankle", "lower", True
        out[f"{side}_hand"] = f"{side}_wrist", f"{side}_elbow", "upper", False  # continues the forearm
        out[f"{side}_foot"] = f"{side}_ankle", None, "lower", False
    return out
