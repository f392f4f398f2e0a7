"""Simulated recordings with exact truth: any body, a motion, a depth camera with the noise of a real one.

Frames: body frame (rest pose: z up, x forward, y left, origin on the floor); fixed frame `base` (on the floor below the
camera, z up, x forward, y left); optical frame (z forward, x right, y down). Host side, NumPy.
"""

from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt16

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.simulate.motion import Motion, as_arrays, pose_body
from voodoo_jax.simulate.room import Room, keep_nearest, render_room
from voodoo_jax.simulate.sensor import TOF_NOISE, Camera, Noise, add_noise, tof_camera

FIXED_FRAME = "base"


def render(
    body: Body, poses: Poses, camera: Camera, room: Room | None
) -> tuple[Float64[np.ndarray, "row column"], Float64[np.ndarray, "row column"]]:
    """Exact depth (optical z, metres, inf where there is nothing) and cosine of the incidence, by ray casting.

    `poses` [limb] T_fixed_limb of the body's limbs, closed elliptic frusta; absent limbs are not seen.
    """
    rays, origin = camera.rays(), np.array(camera.position)
    depth, cosine = (image.ravel() for image in render_room(camera, room))
    sizes, (rotation, translation) = np.asarray(body.sizes, np.float64), as_arrays(poses)
    centres = translation + rotation[..., 2] * sizes[:, 4:] / 2 - origin
    radii = np.hypot(sizes[:, :4].max(1), sizes[:, 4] / 2)
    for limb in np.flatnonzero(np.asarray(body.present)):
        size, r, t, centre, radius = sizes[limb], rotation[limb], translation[limb], centres[limb], radii[limb]
        near = rays_near(rays, centre, radius)
        keep_nearest(depth, cosine, near, *hit_frustum(size, (origin - t) @ r, rays[near] @ r)[:2])
    return depth.reshape(camera.height, camera.width), cosine.reshape(camera.height, camera.width)


def rays_near(rays: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Numbers of the rays from the origin that hit a sphere before it."""
    along = rays @ centre
    return np.nonzero((along > 0) & (along**2 > (centre @ centre - radius**2) * (rays**2).sum(1)))[0]


def hit_frustum(size, o, d) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First hit t [ray] (inf: none) of o + t d with a closed elliptic frustum in its own frame, |cos| there, and the
    surface's normal [ray, 3], of any length and sign."""
    a0, b0, a1, b1, length = size
    t, cosine, normals = np.full(len(d), np.inf), np.ones(len(d)), np.zeros((len(d), 3))
    # the part of the ray within the end planes and the straight cylinder around the frustum
    wide = np.array([max(a0, a1), max(b0, b1)])
    p, q = o[:2] / wide, d[:, :2] / wide
    aa, bb, cc = (q * q).sum(1) + 1e-18, q @ p, p @ p - 1
    disc = bb * bb - aa * cc
    root = np.sqrt(np.maximum(disc, 0))
    dz = np.where(np.abs(d[:, 2]) < 1e-12, 1e-12, d[:, 2])
    planes = np.sort(np.stack([-o[2] / dz, (length - o[2]) / dz]), 0)
    enter = np.maximum(np.maximum((-bb - root) / aa, planes[0]), 0)
    leave = np.minimum((-bb + root) / aa, planes[1])
    some = np.nonzero((disc > 0) & (enter < leave))[0]
    o, d, enter, leave = o[None], d[some], enter[some], leave[some]

    def axes(z):
        return a0 + (a1 - a0) * z / length, b0 + (b1 - b0) * z / length

    def outside(t):
        x, y, z = ((o[:, i] + t * d[:, i]) for i in range(3))
        a, b = axes(z)
        return (x / a) ** 2 + (y / b) ** 2 > 1 + 1e-12

    # bracket the first sample inside, then halve: a quartic otherwise, as the axis ratio changes along the limb
    steps = enter + (leave - enter) * np.linspace(0, 1, 25)[:, None]
    inside = np.stack([~outside(s) for s in steps])
    first = inside.argmax(0)
    found = inside.any(0)
    column = np.arange(len(some))
    high, low = steps[first, column], steps[np.maximum(first - 1, 0), column]
    for _ in range(22):
        middle = (low + high) / 2
        out = outside(middle)
        low, high = np.where(out, middle, low), np.where(out, high, middle)
    hit = o + high[:, None] * d
    a, b = axes(hit[:, 2])
    slope = -(hit[:, 0] ** 2 * (a1 - a0) / a**3 + hit[:, 1] ** 2 * (b1 - b0) / b**3) / length
    normal = np.stack([hit[:, 0] / a**2, hit[:, 1] / b**2, slope], -1)
    on_cap = (first == 0) & (np.minimum(hit[:, 2], length - hit[:, 2]) < 1e-9)
    normal = np.where(on_cap[:, None], [0.0, 0.0, 1.0], normal)
    facing = np.abs((normal * d).sum(1)) / np.linalg.norm(normal, axis=1) / np.linalg.norm(d, axis=1)
    t[some], cosine[some], normals[some] = np.where(found, high, np.inf), facing, normal
    return t, cosine, normals


# A whole recording
@dataclass(frozen=True)
class Simulation:
    """A simulated recording and its truth, in the fixed frame."""

    body: Body
    camera: Camera
    fixed_frame: str
    time_ns: Int64[np.ndarray, " frame"]
    depth: UInt16[np.ndarray, "frame row column"]  # optical z in millimetres, 0: nothing
    rotation: Float32[np.ndarray, "frame limb 4"]  # T_fixed_limb, unit quaternion wxyz
    translation: Float32[np.ndarray, "frame limb 3"]  # metres
    joints: Float32[np.ndarray, "frame centre 3"]  # body.topology.centres, metres


# 8 parameters, all but three with a default
def simulate(
    body: Body,
    motion: Motion,
    camera: Camera | None = None,
    noise: Noise = TOF_NOISE,
    room: Room | None = Room(),  # noqa: B008  frozen
    seed: int = 0,
    start_ns: int = 1_700_000_000_000_000_000,
    present: Bool[np.ndarray, "frame limb"] | None = None,
) -> Simulation:
    """Renders the motion (its root given in the fixed frame, see `placed`); equal arguments give equal bits.

    camera: a tof_camera() if none is given. room None: nothing but the body. start_ns: stamp of the first frame.
    present: which limbs there are in each frame (things picked up and put down), if not those of the body.
    """
    camera = tof_camera() if camera is None else camera
    poses = pose_body(body, motion.root, motion.rotations)
    images = []
    for i in range(len(motion)):
        now = body if present is None else eqx.tree_at(lambda b: b.presence, body, jnp.asarray(present[i], jnp.float32))
        exact = render(now, poses[i], camera, room)
        images.append(add_noise(*exact, camera, noise, np.random.default_rng([seed, i])))
    return Simulation(
        body=body,
        camera=camera,
        fixed_frame=FIXED_FRAME,
        time_ns=start_ns + np.round(motion.time * 1e9).astype(np.int64),
        depth=np.stack(images) if images else np.zeros((0, camera.height, camera.width), np.uint16),
        rotation=np.asarray(poses.rotation, np.float32),
        translation=np.asarray(poses.translation, np.float32),
        joints=np.asarray(jax.vmap(joint_centres, (None, 0))(body, poses), np.float32),
    )


def in_one_picture(*people: Simulation) -> Simulation:
    """The first of some simulations with all their bodies before its camera: each pixel shows the nearest. All must
    have the same camera, room and stamps; the truth is that of the first."""
    first = people[0]
    assert all(p.camera == first.camera and np.array_equal(p.time_ns, first.time_ns) for p in people)
    nothing = np.iinfo(np.uint16).max
    depth = np.min([np.where(p.depth > 0, p.depth, nothing) for p in people], 0)
    return replace(first, depth=np.where(depth < nothing, depth, 0).astype(np.uint16))
