"""Start poses besides the rest pose: arms raised or stretched out, sitting. For bodies with such joints."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rigid import Poses, on_device, on_host
from voodoo_jax.model.body import Body, places_from_joints, tree_order

SHOULDERS, HIPS = ("l_shoulder", "r_shoulder"), ("l_hip", "r_hip")
Turn = tuple[str, str, float]  # joint, axis, degrees


class Stance(NamedTuple):
    """A pose by the turns of joints, about the body's x (forward) and y (left) axes, relative to the rest pose."""

    turns: tuple[Turn, ...]
    sizes: tuple[float, ...]  # the body's scale over the one that its highest point would give


def both(joint: str, axis: str, degrees: float) -> tuple[Turn, ...]:
    """Left and right joint turned alike: about y forwards (negative) or backwards, about x outwards."""
    return (f"l_{joint}", axis, degrees), (f"r_{joint}", axis, -degrees if axis == "x" else degrees)


LEFT, RIGHT = both("shoulder", "x", 170.0)
STANCES = (
    # the hand may be what is highest
    Stance((LEFT,), (1.0, 0.87)),
    Stance((RIGHT,), (1.0, 0.87)),
    Stance((LEFT, RIGHT), (1.0, 0.87)),
    Stance(both("shoulder", "x", 90.0), (1.0,)),  # as body scanners ask for
    # a seat of 45 cm: a sitting adult's head is at about 78 % of the stature; hands in the lap
    Stance(
        (*both("hip", "y", -85.0), *both("knee", "y", 85.0), *both("shoulder", "y", -25.0), *both("elbow", "y", -50.0)),
        (1.24, 1.28, 1.32),
    ),
)
# of who lies, on their side most of all
CURLED = Stance(
    (*both("hip", "y", -40.0), *both("knee", "y", 55.0), *both("shoulder", "y", -45.0), *both("elbow", "y", -60.0)),
    (1.0,),
)


def in_stance(body: Body, stance: Stance) -> Body | None:
    """The body with a stance as its rest pose, its lowest limb at the same height; None if it is no person or lacks a
    joint."""
    rest = rest_in_stance(on_host(body), stance)
    return None if rest is None else on_device(eqx.tree_at(lambda b: b.rest, body, rest))


def rest_in_stance(body: Body, stance: Stance) -> Poses | None:
    """The rest pose of `in_stance` alone, of a body on the host: transfers to the device and back are slow."""
    t = body.topology
    if body.scale_name != "stature" or not {joint for joint, *_ in stance.turns} <= set(t.joints):
        return None
    turn = Rotation.from_quat(body.rest.rotation, scalar_first=True)
    for joint, axis, degrees in stance.turns:
        limbs = beyond(body, t.joints.index(joint))
        quats = turn.as_quat(scalar_first=True)
        moved = Rotation.from_euler(axis, degrees, degrees=True) * Rotation.from_quat(quats[limbs], scalar_first=True)
        quats[limbs] = moved.as_quat(scalar_first=True)
        turn = Rotation.from_quat(quats, scalar_first=True)
    new = Poses(turn.as_quat(scalar_first=True).astype(np.float32), body.rest.translation)
    places = places_from_joints(body, new)
    lower = np.zeros(3, np.float32)
    lower[2] = np.min(body.rest.translation[:, 2]) - np.min(places[:, 2])
    return Poses(new.rotation, places + lower)


def beyond(body: Body, joint: int) -> np.ndarray:
    """The descendants of a joint, its own limb first."""
    t = body.topology
    out = [t.children[joint]]
    for j in tree_order(t):
        if t.parents[j] in out:
            out.append(t.children[j])
    return np.array(out)


def exchanged(body: Body, poses: Poses, joints: tuple[str, ...]) -> Poses:
    """The poses with the limbs beyond the left and right joints exchanged."""
    t, source = body.topology, np.arange(body.limb_count)
    for joint in joints:
        for limb in beyond(body, t.joints.index(joint)):
            name = t.limbs[limb]
            twin = {"l": "r", "r": "l"}.get(name[0], "") + name[1:]
            source[limb] = t.limbs.index(twin) if twin in t.limbs else limb
    return poses[source]
