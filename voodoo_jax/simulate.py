"""Simulated recordings with exact truth: any body, a motion, a depth camera with the noise of a real one.

Frames: body frame (rest pose: z up, x forward, y left, origin on the floor); fixed frame `base` (on the floor below the
camera, z up, x forward, y left); optical frame (z forward, x right, y down). Host side, NumPy.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64, UInt16
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rigid import Poses, apply, compose, inverse, quat_exp, quat_multiply, unrotate
from voodoo_jax.model.body import Body, joint_centres, tree_order
from voodoo_jax.records.tracks import Status, Tracks

MOTIONS = ("stand", "wave", "bow", "walk", "swing")
FIXED_FRAME = "base"


# Motion: rotations of the joints and a pose of the root over time


@dataclass(frozen=True)
class Motion:
    """How a body moves. `root` is T_body_root from the functions here, T_fixed_root after `placed`."""

    time: Float64[np.ndarray, " frame"]  # seconds from the start
    root: Poses  # [frame] of limb 0, metres
    rotations: Float[np.ndarray, "frame joint 3"]  # rotation vectors in the joints' frames, radians; zero: rest pose

    def __len__(self) -> int:
        return len(self.time)


def pose_body(body: Body, root: Poses, rotations: Float[np.ndarray, "*frame joint 3"]) -> Poses:
    """Forward kinematics: poses [*frame, limb] in the frame of `root` [*frame]; NumPy, leading axes are free.

    Each child is hung on its parent with the two anchors together, turned by the joint's rotation vector (radians, in
    the joint's frame). All rotations zero gives the rest pose if the anchors coincide in it.
    """
    # not JAX: compiled for the CPU, the chain of quaternion products is fused without end (minutes)
    t = body.topology
    rotations = np.asarray(rotations, np.float64)
    turns = Rotation.from_rotvec(rotations.reshape(-1, 3)).as_matrix().reshape(*rotations.shape, 3)
    (parent_turn, parent_at), (child_turn, child_at) = _arrays(body.parent_anchor), _arrays(body.child_anchor)
    found = {0: _arrays(root)}
    for j in tree_order(t):
        turn, at = found[t.parents[j]]
        at = at + turn @ parent_at[j]
        turn = turn @ parent_turn[j] @ turns[..., j, :, :] @ child_turn[j].T
        found[t.children[j]] = turn, at - turn @ child_at[j]
    turns, places = (np.stack([found[i][k] for i in range(len(t.limbs))], -2 - (k == 0)) for k in (0, 1))
    quaternions = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat(scalar_first=True, canonical=True)
    return Poses(jnp.asarray(quaternions.reshape(*turns.shape[:-2], 4), jnp.float32), jnp.asarray(places, jnp.float32))


def make_motion(body: Body, name: str, seconds: float = 3.0, rate: float = 30.0) -> Motion:
    """One of MOTIONS at `rate` frames per second, in the body frame; starts and ends in the relaxed pose.

    "swing" moves every joint of any body about its free axes; the others turn the joints of a person that the body has,
    by name. Raises ValueError for an unknown name.
    """
    time = np.arange(round(seconds * rate)) / rate
    if name == "swing":
        return _motion(body, time, {}, _swing_rotations(body, time))
    one, zero = np.ones_like(time), np.zeros_like(time)
    window = _ease(time, 0, min(0.7, seconds / 3)) * (1 - _ease(time, seconds - min(0.7, seconds / 3), seconds))
    vector = lambda x, y, z: np.stack([x * one, y * one, z * one], -1)  # noqa: E731
    bend = lambda angle: vector(0, -angle, 0)  # noqa: E731  limb swings forward, about the axis to the right
    mix = lambda relaxed, target: relaxed + window[:, None] * (target - relaxed)  # noqa: E731
    # relaxed: arms slightly off the trunk, elbows slightly bent
    turns = {"l_elbow": bend(0.15), "r_elbow": bend(0.15)}
    turns |= {"l_shoulder": vector(0.1, 0, 0), "r_shoulder": vector(-0.1, 0, 0)}
    if name == "stand":
        return _motion(body, time, turns)
    if name == "wave":
        # upper arm to the side, turned about itself so that the bent elbow points the forearm up
        lifted = (Rotation.from_rotvec([-1.7, 0, 0]) * Rotation.from_rotvec([0, 0, -np.pi / 2])).as_rotvec()
        turns["r_shoulder"] = mix(turns["r_shoulder"], vector(*lifted))
        turns["r_elbow"] = mix(turns["r_elbow"], bend(1.2 + 0.4 * np.sin(2 * np.pi * 1.5 * time)))
        return _motion(body, time, turns)
    if name == "bow":
        angle = 0.75 * window
        share = 0.5 if "waist" in body.topology.joints else 1.0  # of the pelvis; the waist does the rest
        turns |= {"waist": bend(-(1 - share) * angle), "neck": bend(-0.3 * angle)}
        turns |= {"l_hip": bend(share * angle), "r_hip": bend(share * angle)}
        turns["l_shoulder"] = turns["l_shoulder"] + bend(0.9 * angle)
        turns["r_shoulder"] = turns["r_shoulder"] + bend(0.9 * angle)
        return _grounded(body, _motion(body, time, turns, lean=bend(-share * angle)))
    if name == "walk":
        for side, phase in (("l", 0.0), ("r", np.pi)):
            stride = 2 * np.pi * 0.9 * time + phase
            hip = 0.05 + 0.42 * np.sin(stride)
            knee = 0.12 + 0.75 * np.maximum(np.cos(stride + 0.3), 0) ** 2  # bends while the leg comes forward
            turns[f"{side}_hip"], turns[f"{side}_knee"] = bend(window * hip), bend(-window * knee)
            turns[f"{side}_ankle"] = bend(window * 0.6 * np.clip(knee - hip, -0.3, 0.3))
            turns[f"{side}_shoulder"] = turns[f"{side}_shoulder"] + bend(-window * 0.35 * np.sin(stride))
            turns[f"{side}_elbow"] = bend(0.15 + 0.2 * window)
        return _grounded(body, _motion(body, time, turns, lean=vector(zero, 0.06 * window, zero)), rolling=True)
    raise ValueError(f"no motion named '{name}'; there are {', '.join(MOTIONS)}")


def sequence(*motions: Motion) -> Motion:
    """Motions of one body one after the other; each starts where the one before it ended. At least one."""
    time, root, rotations = [motions[0].time], [motions[0].root], [motions[0].rotations]
    for motion in motions[1:]:
        step = motion.time[1] - motion.time[0] if len(motion) > 1 else 1 / 30
        time.append(motion.time + time[-1][-1] + step)
        root.append(compose(compose(root[-1][-1], inverse(motion.root[0])), motion.root))
        rotations.append(motion.rotations)
    joined = Poses(*(jnp.concatenate(x) for x in zip(*((p.rotation, p.translation) for p in root))))
    return Motion(np.concatenate(time), joined, np.concatenate(rotations))


def placed(motion: Motion, x: float, y: float, yaw: float) -> Motion:
    """The motion of a body that stands at x, y (metres) in the fixed frame and faces `yaw` (radians from +x to +y)."""
    place = Poses(quat_exp(jnp.array([0.0, 0.0, yaw])), jnp.array([x, y, 0.0]))
    return replace(motion, root=compose(place, motion.root))


def _ease(t, start: float, end: float):
    s = np.clip((t - start) / max(end - start, 1e-9), 0, 1)
    return s * s * (3 - 2 * s)


def _motion(body: Body, time, turns: Mapping[str, np.ndarray], rotations=None, lean=None) -> Motion:
    """From rotation vectors about the body frame's axes; `lean` [frame, 3] turns the root about the hips' middle."""
    t, count = body.topology, len(time)
    rotations = np.zeros((count, len(t.joints), 3), np.float32) if rotations is None else rotations
    for j, name in enumerate(t.joints):
        if name in turns:
            frame = quat_multiply(body.rest.rotation[t.parents[j]], body.parent_anchor.rotation[j])
            rotations[:, j] = np.asarray(unrotate(frame, jnp.asarray(turns[name], jnp.float32)))
    lean = np.zeros((count, 3), np.float32) if lean is None else lean
    hips = [j for j, name in enumerate(t.joints) if name in ("l_hip", "r_hip")]
    at = [apply(body.rest[t.parents[j]], body.parent_anchor.translation[j]) for j in hips] or [jnp.zeros(3)]
    pivot = jnp.mean(jnp.stack(at), 0)
    turn = Poses(quat_exp(jnp.asarray(lean, jnp.float32)), jnp.broadcast_to(pivot, (count, 3)))
    return Motion(time, compose(compose(turn, Poses(jnp.array([1.0, 0, 0, 0]), -pivot)), body.rest[0]), rotations)


def _swing_rotations(body: Body, time) -> Float32[np.ndarray, "frame joint 3"]:
    """Universal joints turn about all axes, hinges about their ellipse's axis, elliptic (stiff) ones a little."""
    axes = np.asarray(body.axes) > 0
    free = np.where(axes.any(1, keepdims=True), np.concatenate([axes, np.zeros_like(axes[:, :1])], 1), True)
    amplitude = np.where(axes.all(1), 0.12, np.where(axes.any(1), 0.5, 0.3))[:, None] * free
    # golden ratio: no two joints or axes in step
    phase = 2 * np.pi * ((np.arange(amplitude.size) * 0.6180339887) % 1).reshape(amplitude.shape)
    wave = np.sin(2 * np.pi * 0.4 * time[:, None, None] + phase) * _ease(time, 0, 0.7)[:, None, None]
    return (amplitude * wave).astype(np.float32)


def _grounded(body: Body, motion: Motion, rolling: bool = False) -> Motion:
    """Moves the root up or down so that the lowest point stays at its height in the rest pose.

    rolling: also forward, so that the lowest limb end does not slide over the floor.
    """
    ends, heights = _limb_ends(body, pose_body(body, motion.root, motion.rotations))
    _, rest_heights = _limb_ends(body, body.rest)
    shift = np.zeros((len(motion), 3))
    shift[:, 2] = rest_heights.min() - heights.min(-1)
    if rolling:
        low, frames = heights.argmin(-1), np.arange(len(motion) - 1)
        # never backwards: a person who stops draws the rear leg up
        shift[1:, 0] = np.cumsum(np.maximum(ends[frames, low[:-1], 0] - ends[frames + 1, low[:-1], 0], 0))
    root = Poses(motion.root.rotation, motion.root.translation + jnp.asarray(shift, jnp.float32))
    return replace(motion, root=root)


def _limb_ends(body: Body, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Centres [..., 2 limb, 3] of all end ellipses and the height of each ellipse's lowest point [..., 2 limb]."""
    sizes, (rotation, translation) = np.asarray(body.sizes, np.float64), _arrays(poses)
    top = translation + rotation[..., 2] * sizes[:, 4:]
    drop = lambda a, b: np.hypot(a * rotation[..., 2, 0], b * rotation[..., 2, 1])  # noqa: E731
    heights = [translation[..., 2] - drop(sizes[:, 0], sizes[:, 1]), top[..., 2] - drop(sizes[:, 2], sizes[:, 3])]
    return np.concatenate([translation, top], -2), np.concatenate(heights, -1)


def _arrays(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrices [..., 3, 3] and translations [..., 3] in float64."""
    q = np.asarray(poses.rotation, np.float64)
    matrix = Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_matrix()
    return matrix.reshape(*q.shape[:-1], 3, 3), np.asarray(poses.translation, np.float64)


# Camera, room and noise


@dataclass(frozen=True)
class Camera:
    """Pinhole depth camera without distortion; pixel centres at integer coordinates. Pose T_fixed_optical."""

    width: int
    height: int
    fx: float  # pixels
    fy: float
    cx: float
    cy: float
    position: tuple[float, float, float] = (0.0, 0.0, 1.2)  # metres
    pitch: float = 0.0  # radians downwards
    yaw: float = 0.0  # radians from +x to +y
    roll: float = 0.0  # radians about where it looks, clockwise as it sees

    @property
    def rotation(self) -> Float64[np.ndarray, "3 3"]:
        """Rotation matrix of T_fixed_optical: columns are the optical x (right), y (down), z (forward)."""
        (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (self.pitch, self.yaw))
        forward, right = np.array([cp * cy, cp * sy, -sp]), np.array([sy, -cy, 0.0])
        level = np.stack([right, np.cross(forward, right), forward], -1)
        return level @ Rotation.from_euler("z", self.roll).as_matrix() if self.roll else level

    def rays(self) -> Float64[np.ndarray, "pixel 3"]:
        """Directions through the pixel centres, row by row, in the fixed frame; one metre of optical z long."""
        v, u = np.mgrid[: self.height, : self.width].reshape(2, -1)
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones(u.size)], -1) @ self.rotation.T


def tof_camera(height: float = 1.2, pitch: float = 0.07) -> Camera:
    """A time-of-flight camera of 160 x 124 pixels and 47.5 x 39.6 degrees, `height` metres above the floor."""
    fx, fy = 80 / np.tan(np.radians(47.5 / 2)), 62 / np.tan(np.radians(39.6 / 2))
    return Camera(160, 124, float(fx), float(fy), 79.5, 61.5, (0.0, 0.0, height), pitch)


def kinect_camera(height: float = 1.2, pitch: float = 0.07) -> Camera:
    """A Kinect v1 read at every second pixel: 320 x 240 pixels, focal length 290 pixels."""
    return Camera(320, 240, 290.0, 290.0, 159.5, 119.5, (0.0, 0.0, height), pitch)


@dataclass(frozen=True)
class Box:
    """A piece of furniture on the floor, metres and radians."""

    x: float
    y: float
    size: tuple[float, float, float]
    yaw: float = 0.0


@dataclass(frozen=True)
class Room:
    """What surrounds the body: the floor z = 0, a back wall at x = wall and boxes. None: without."""

    floor: bool = True
    wall: float | None = 5.0
    boxes: tuple[Box, ...] = (Box(2.9, 0.95, (0.5, 0.45, 0.75), 0.3),)


@dataclass(frozen=True)
class Noise:
    """sigma(d) = constant + quadratic d^2 along the ray, metres; see TOF_NOISE, KINECT_NOISE, NO_NOISE."""

    constant: float = 0.0
    quadratic: float = 0.0  # per metre
    flying: float = 0.0  # share of the pixels at depth edges that mix both depths
    dropout: float = 0.0  # share of pixels lost anywhere
    grazing: float = 0.0  # cosine of the incidence below which pixels begin to get lost
    disparity: float = 0.0  # focal length x baseline / disparity step, metres; 0: none. Depth is quantised in 1 / z
    edge: float = 0.05  # step between neighbours that makes a depth edge, metres
    max_range: float = 60.0  # metres of optical z


NO_NOISE = Noise()
TOF_NOISE = Noise(0.004, 0.0015, flying=0.5, dropout=0.005, grazing=0.15, max_range=7.5)
KINECT_NOISE = Noise(0.0, 1.425e-3, flying=0.1, dropout=0.01, grazing=0.2, disparity=580 * 0.075 * 8, max_range=8.0)


def render(
    body: Body, poses: Poses, camera: Camera, room: Room | None
) -> tuple[Float64[np.ndarray, "row column"], Float64[np.ndarray, "row column"]]:
    """Exact depth (optical z, metres, inf where nothing is) and cosine of the incidence, by ray casting.

    `poses` [limb] T_fixed_limb of the body's limbs, closed elliptic frusta; absent limbs are not seen.
    """
    rays, origin = camera.rays(), np.array(camera.position)
    depth, cosine = (image.ravel() for image in render_room(camera, room))
    sizes, (rotation, translation) = np.asarray(body.sizes, np.float64), _arrays(poses)
    centres = translation + rotation[..., 2] * sizes[:, 4:] / 2 - origin
    radii = np.hypot(sizes[:, :4].max(1), sizes[:, 4] / 2)
    for limb in np.flatnonzero(np.asarray(body.present)):
        size, r, t, centre, radius = sizes[limb], rotation[limb], translation[limb], centres[limb], radii[limb]
        # only the rays that meet the limb's bounding sphere
        along = rays @ centre
        near = np.nonzero((along > 0) & (along**2 > (centre @ centre - radius**2) * (rays**2).sum(1)))[0]
        _keep_nearest(depth, cosine, near, *_hit_frustum(size, (origin - t) @ r, rays[near] @ r))
    return depth.reshape(camera.height, camera.width), cosine.reshape(camera.height, camera.width)


def render_room(
    camera: Camera, room: Room | None
) -> tuple[Float64[np.ndarray, "row column"], Float64[np.ndarray, "row column"]]:
    """As render, of a room that nobody is in."""
    rays, origin = camera.rays(), np.array(camera.position)
    depth, cosine, every = np.full(len(rays), np.inf), np.ones(len(rays)), np.arange(len(rays))
    planes = [] if room is None else [(2, 0.0)] * room.floor + ([] if room.wall is None else [(0, room.wall)])
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.linalg.norm(rays, axis=1)
        for axis, at in planes:
            _keep_nearest(depth, cosine, every, (at - origin[axis]) / rays[:, axis], np.abs(rays[:, axis]) / length)
        for box in room.boxes if room else ():
            _keep_nearest(depth, cosine, every, *hit_box(box, origin, rays))
    return depth.reshape(camera.height, camera.width), cosine.reshape(camera.height, camera.width)


def _keep_nearest(depth, cosine, index, t, c) -> None:
    with np.errstate(invalid="ignore"):
        closer = (t > 0) & (t < depth[index])
    depth[index[closer]], cosine[index[closer]] = t[closer], c[closer]


def _hit_frustum(size, o, d) -> tuple[np.ndarray, np.ndarray]:
    """First hit t [ray] (inf: none) of o + t d with a closed elliptic frustum in its own frame, and |cos| there."""
    a0, b0, a1, b1, length = size
    t, cosine = np.full(len(d), np.inf), np.ones(len(d))
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
    t[some], cosine[some] = np.where(found, high, np.inf), facing
    return t, cosine


def hit_box(box: Box, origin, rays) -> tuple[np.ndarray, np.ndarray]:
    """First hit t [ray] (inf: none) of origin + t ray with a box, and |cos| there; one origin, or each ray's own."""
    turn = Rotation.from_euler("z", box.yaw).as_matrix()
    half = np.array(box.size) / 2
    o, d = (origin - [box.x, box.y, half[2]]) @ turn, rays @ turn
    ends = np.sort(np.stack([(-half - o) / d, (half - o) / d]), 0)
    axis = ends[0].argmax(1)
    enter = ends[0].max(1)
    cosine = np.abs(d[np.arange(len(d)), axis]) / np.linalg.norm(d, axis=1)
    return np.where(enter < ends[1].min(1), enter, np.inf), cosine


def add_noise(
    depth: Float64[np.ndarray, "row column"],
    cosine: Float64[np.ndarray, "row column"],
    camera: Camera,
    noise: Noise,
    rng: np.random.Generator,
) -> UInt16[np.ndarray, "row column"]:
    """What the camera delivers: optical z in millimetres, 0 where it has nothing."""
    height, width = depth.shape
    # flying pixels: a random one of the four neighbours shares the pixel
    side, share, flies = rng.integers(0, 4, depth.shape), rng.random(depth.shape), rng.random(depth.shape)
    row, column = np.mgrid[:height, :width]
    row = np.clip(row + np.array([0, 0, -1, 1])[side], 0, height - 1)
    column = np.clip(column + np.array([-1, 1, 0, 0])[side], 0, width - 1)
    neighbour = depth[row, column]
    seen = np.isfinite(depth) & (depth < noise.max_range)
    z, other = np.where(seen, depth, 1.0), np.where(np.isfinite(neighbour), neighbour, 1.0)
    mixed = (flies < noise.flying) & np.isfinite(neighbour) & (np.abs(z - other) > noise.edge)
    z = np.where(mixed, z + share * (other - z), z)
    stretch = np.linalg.norm(camera.rays(), axis=1).reshape(depth.shape)  # range per optical z
    z = z + rng.standard_normal(depth.shape) * (noise.constant + noise.quadratic * (z * stretch) ** 2) / stretch
    if noise.disparity:
        z = noise.disparity / np.maximum(np.round(noise.disparity / np.maximum(z, 1e-3)), 1)
    lost = rng.random(depth.shape) < noise.dropout
    lost |= rng.random(depth.shape) > cosine / max(noise.grazing, 1e-9)
    millimetres = np.round(z * 1000)
    return np.where(seen & ~lost & (millimetres > 0) & (z < noise.max_range), millimetres, 0).astype(np.uint16)


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
        now = body if present is None else eqx.tree_at(lambda b: b.present, body, jnp.asarray(present[i]))
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


def truth_tracks(simulation: Simulation, source: str = "simulation") -> Tracks:
    """The truth as if it had been tracked: what a perfect tracker would return."""
    s, count = simulation, len(simulation.time_ns)
    zeros, steps = np.zeros(count, np.float32), np.zeros(count, np.int32)
    points = (s.depth > 0).sum((1, 2)).astype(np.int32)
    weight = np.ones(s.rotation.shape[:2], np.float32)
    return Tracks(
        source=source,
        fixed_frame=s.fixed_frame,
        body=s.body,
        time_ns=s.time_ns,
        rotation=s.rotation,
        translation=s.translation,
        joints=s.joints,
        status=np.full(count, Status.TRACKED, np.int8),
        residual=zeros,
        explained=zeros + 1,
        steps=steps,
        points=points,
        limb_weight=weight,
    )
