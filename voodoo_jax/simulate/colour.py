"""Simulated colour recordings with exact truth: stereo pairs, or a colour camera beside a depth camera.

The body is the one that depth is simulated with, its gaps at the joints closed by balls, dressed and lit; the room is
painted. Frames as in `recording`. Host side, NumPy.
"""

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float32, Float64, Int, Int64, UInt8, UInt16
from scipy.ndimage import gaussian_filter

from voodoo_jax.geometry.rigid import Poses, compose, inverse
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.simulate.looks import Look, Scenery, body_colours, painted
from voodoo_jax.simulate.motion import Motion, as_arrays, pose_body
from voodoo_jax.simulate.recording import FIXED_FRAME, hit_frustum, rays_near
from voodoo_jax.simulate.room import Room, hit_box, keep_nearest, render_room
from voodoo_jax.simulate.sensor import TOF_NOISE, Camera, Noise, add_noise

GREY_NOISE = 2.0  # standard deviation of a pixel, of 255
_BALL = 0.9  # of the thinnest end at a joint: a ball there closes the gap and looks out nowhere
_BLUR = 0.6  # pixels: standard deviation of a lens's picture of a point
_GAINS = (1.0, 0.97)  # exposures of two cameras are never quite the same


@dataclass(frozen=True)
class Surface:
    """The body's surface as seen by a camera, for each pixel that shows it, row by row."""

    pixel: Int[np.ndarray, " n"]
    limb: Int[np.ndarray, " n"]
    depth: Float64[np.ndarray, " n"]  # optical z, metres
    normal: Float64[np.ndarray, "n 3"]  # unit, towards the camera, fixed frame


@dataclass(frozen=True)
class ColourSimulation:
    """A simulated colour recording and its truth, in the fixed frame."""

    body: Body
    cameras: tuple[Camera, ...]  # of the images: left and right, or one
    fixed_frame: str
    time_ns: Int64[np.ndarray, " frame"]
    images: tuple[UInt8[np.ndarray, "frame row column 3"], ...]  # of each camera: red, green, blue
    depth_camera: Camera | None
    depth: UInt16[np.ndarray, "shot line pixel"]  # of the depth camera, optical z in millimetres; no shot without one
    rotation: Float32[np.ndarray, "frame limb 4"]  # T_fixed_limb, unit quaternion wxyz
    translation: Float32[np.ndarray, "frame limb 3"]  # metres
    joints: Float32[np.ndarray, "frame centre 3"]  # body.topology.centres, metres


def stereo_cameras(
    height: float = 1.3, pitch: float = 0.16, baseline: float = 0.11, width: int = 640
) -> tuple[Camera, Camera]:
    """The left and the right camera of a rectified pair of 62 x 48 degrees, `height` and `baseline` in metres."""
    rows, focal = width * 3 // 4, 0.832 * width
    left = Camera(width, rows, focal, focal, (width - 1) / 2, (rows - 1) / 2, (0.0, 0.0, height), pitch)
    x, y, z = np.array(left.position) + baseline * left.rotation[:, 0]
    return left, replace(left, position=(float(x), float(y), float(z)))


# 9 parameters: all but three with a default
def simulate_colour(
    body: Body,
    motion: Motion,
    cameras: tuple[Camera, ...] | None = None,
    depth_camera: Camera | None = None,
    look: Look = Look(),  # noqa: B008  frozen
    scenery: Scenery = Scenery(),  # noqa: B008  frozen
    room: Room = Room(),  # noqa: B008  frozen
    noise: Noise = TOF_NOISE,
    seed: int = 0,
    start_ns: int = 1_700_000_000_000_000_000,
) -> ColourSimulation:
    """Renders the motion (its root given in the fixed frame, see `placed`); equal arguments give equal bits.

    cameras: stereo_cameras() if none are given; one with `depth_camera`, a depth camera with `noise` beside it.
    start_ns: stamp of the first frame.
    """
    cameras = stereo_cameras() if cameras is None else cameras
    poses = pose_body(body, motion.root, motion.rotations)
    backgrounds = [room_picture(camera, room, scenery) for camera in cameras]
    images, depth = [[] for _ in cameras], []
    empty = None if depth_camera is None else render_room(depth_camera, room)
    for i in range(len(motion)):
        rng = np.random.default_rng([seed, i])
        for camera, background, gain, out in zip(cameras, backgrounds, _GAINS, images):
            out.append(exposed(picture(body, poses[i], camera, background, look, scenery), gain, rng))
        if depth_camera is not None and empty is not None:
            depth.append(add_noise(*_measured(body, poses[i], depth_camera, empty), depth_camera, noise, rng))
    nothing = (0, 0, 0) if depth_camera is None else (0, depth_camera.height, depth_camera.width)
    return ColourSimulation(
        body=body,
        cameras=cameras,
        fixed_frame=FIXED_FRAME,
        time_ns=start_ns + np.round(motion.time * 1e9).astype(np.int64),
        images=tuple(np.stack(each) for each in images),
        depth_camera=depth_camera,
        depth=np.stack(depth) if depth else np.zeros(nothing, np.uint16),
        rotation=np.asarray(poses.rotation, np.float32),
        translation=np.asarray(poses.translation, np.float32),
        joints=np.asarray(jax.vmap(joint_centres, (None, 0))(body, poses), np.float32),
    )


def surface(body: Body, poses: Poses, camera: Camera) -> Surface:
    """The surface of a body that a camera sees, `poses` [limb] T_fixed_limb: its frusta, and a ball in each joint."""
    origin, sizes, (turn, at) = np.array(camera.position), np.asarray(body.sizes, np.float64), as_arrays(poses)
    pixels = _around(at + turn[..., 2] * sizes[:, 4:] / 2, np.hypot(sizes[:, :4].max(1), sizes[:, 4] / 2), camera)
    rays = camera.rays(pixels)
    depth, limb, normal = np.full(len(rays), np.inf), np.zeros(len(rays), int), np.zeros((len(rays), 3))

    def met(near: np.ndarray, t: np.ndarray, n: np.ndarray, number: int) -> None:
        closer = (t > 0) & (t < depth[near])
        depth[near[closer]], limb[near[closer]], normal[near[closer]] = t[closer], number, n[closer]

    for number in np.flatnonzero(np.asarray(body.present)).tolist():
        size, r, place = sizes[number], turn[number], at[number]
        centre = place + r[:, 2] * size[4] / 2 - origin
        near = rays_near(rays, centre, float(np.hypot(size[:4].max(), size[4] / 2)))
        t, _, n = hit_frustum(size, (origin - place) @ r, rays[near] @ r)
        met(near, t, n @ r.T, number)
    for number, centre, radius in _balls(body, turn, at):
        near = rays_near(rays, centre - origin, radius)
        t, n = _hit_ball(centre - origin, radius, rays[near])
        met(near, t, n, number)
    seen = np.flatnonzero(np.isfinite(depth))
    n = normal[seen]
    n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    n = n * -np.sign((n * rays[seen]).sum(1, keepdims=True))
    return Surface(pixels[seen], limb[seen], depth[seen], n)


def _around(centres: np.ndarray, radii: np.ndarray, camera: Camera) -> Int[np.ndarray, " n"]:
    """Numbers of the pixels of a window that contains all of some balls; all pixels if one is at the camera."""
    local = (centres - np.array(camera.position)) @ camera.rotation
    size, near = np.array([camera.width, camera.height]), (local[:, 2] - radii)[:, None]
    if near.min() < 0.1:
        return np.arange(size.prod())
    focal, middle = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    # a ball is seen within what its cube is at its nearest, on either side of the middle
    ends = [local[:, :2] + side * radii[:, None] for side in (-1, 1)]
    shown = np.concatenate([end / z for end in ends for z in (near, near + 2 * radii[:, None])]) * focal + middle
    low = np.clip(np.floor(shown.min(0)).astype(int), 0, size)
    high = np.clip(np.ceil(shown.max(0)).astype(int) + 1, 0, size)
    return (np.arange(low[1], high[1])[:, None] * camera.width + np.arange(low[0], high[0])).ravel()


def _balls(body: Body, turn: np.ndarray, at: np.ndarray) -> list[tuple[int, np.ndarray, float]]:
    """Balls in the joints of the limbs that are present: the limb whose colour each has, its centre and radius."""
    sizes, t, present = np.asarray(body.sizes, np.float64), body.topology, np.asarray(body.present)
    anchors, out = np.asarray(body.parent_anchor.translation, np.float64), []
    for j, (parent, child) in enumerate(zip(t.parents, t.children)):
        if present[parent] and present[child]:
            end = sizes[parent, 2:4] if anchors[j, 2] > sizes[parent, 4] / 2 else sizes[parent, :2]
            radius = _BALL * float(min(*end, *sizes[child, :2]))
            out.append((child, at[parent] + turn[parent] @ anchors[j], radius))
    return out


def _hit_ball(centre: np.ndarray, radius: float, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First hit t [ray] (inf: none) of rays from the origin with a ball, and the normal there."""
    aa, bb = (rays**2).sum(1), rays @ centre
    disc = bb**2 - aa * (centre @ centre - radius**2)
    t = np.where(disc > 0, (bb - np.sqrt(np.maximum(disc, 0))) / aa, np.inf)
    return t, np.where(disc > 0, t, 0)[:, None] * rays - centre


def _measured(body: Body, poses: Poses, camera: Camera, empty) -> tuple[np.ndarray, np.ndarray]:
    """Exact depth and cosine of the incidence of a body in a room, as `recording.render`."""
    depth, cosine = (image.copy().ravel() for image in empty)
    s = surface(body, poses, camera)
    rays = camera.rays(s.pixel)
    facing = np.abs((s.normal * rays).sum(1)) / np.linalg.norm(rays, axis=1)
    keep_nearest(depth, cosine, s.pixel, s.depth, facing)
    return depth.reshape(camera.height, camera.width), cosine.reshape(camera.height, camera.width)


def _lit(colours: np.ndarray, normal: np.ndarray, scenery: Scenery) -> np.ndarray:
    light = np.array(scenery.light) / np.linalg.norm(scenery.light)
    shade = scenery.ambient + (1 - scenery.ambient) * np.maximum(normal @ light, 0)
    return colours * shade[:, None] * np.array(scenery.tint)


def room_picture(
    camera: Camera, room: Room, scenery: Scenery
) -> tuple[Float64[np.ndarray, " pixel"], Float64[np.ndarray, "pixel 3"]]:
    """Depth (optical z, metres, inf where there is nothing) and picture of an empty room, row by row."""
    rays, origin = camera.rays(), np.array(camera.position)
    depth = render_room(camera, room)[0].ravel()
    out, normal = np.zeros((len(rays), 3)), np.zeros((len(rays), 3))
    nearest = [hit_box(box, origin, rays)[0] for box in room.boxes]
    which = np.where(np.isfinite(depth), 2, -1)
    which[np.min([np.full(len(rays), np.inf), *nearest], 0) <= depth + 1e-9] = 2
    points = origin + rays * np.where(np.isfinite(depth), depth, 0)[:, None]
    which[(which == 2) & room.floor & (np.abs(points[:, 2]) < 1e-6)] = 0
    if room.wall is not None:
        which[(which == 2) & (np.abs(points[:, 0] - room.wall) < 1e-6)] = 1
    normal[which == 0], normal[which == 1] = (0, 0, 1), (-1, 0, 0)
    for box, t in zip(room.boxes, nearest):
        mine = (which == 2) & (t <= depth + 1e-9)
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        local = (points[mine] - [box.x, box.y, box.size[2] / 2]) @ turn / (np.array(box.size) / 2)
        axis = np.abs(local).argmax(1)
        normal[mine] = np.sign(np.take_along_axis(local, axis[:, None], 1)) * turn.T[axis]
    for number, paint in enumerate((scenery.floor, scenery.wall, scenery.furniture)):
        mine = which == number
        out[mine] = painted(paint, points[mine], number)
    return depth, _lit(out, normal, scenery)


# 6 parameters and the look
def picture(
    body: Body, poses: Poses, camera: Camera, background: tuple[np.ndarray, np.ndarray], look: Look, scenery: Scenery
) -> Float64[np.ndarray, "row column 3"]:
    """Light on a camera's sensor: a body in the room of `room_picture`. Red, green, blue, 0..255."""
    s = surface(body, poses, camera)
    there = s.depth < background[0][s.pixel]
    pixel, limb, normal = s.pixel[there], s.limb[there], s.normal[there]
    points = np.array(camera.position) + camera.rays(pixel) * s.depth[there, None]
    turn, at = as_arrays(compose(body.rest, inverse(poses)))
    place = np.einsum("nij,nj->ni", turn[limb], points) + at[limb]
    image = background[1].copy()
    image[pixel] = _lit(body_colours(body, look, limb, place), normal, scenery)
    return image.reshape(camera.height, camera.width, 3)


def exposed(
    image: Float64[np.ndarray, "row column 3"], gain: float, rng: np.random.Generator
) -> UInt8[np.ndarray, "row column 3"]:
    """The camera's image: a little blurred by its lens, with noise."""
    image = gaussian_filter(image.astype(np.float32), (_BLUR, _BLUR, 0))
    image = gain * image + GREY_NOISE * rng.standard_normal(image.shape, np.float32)
    return np.clip(image, 0, 255).astype(np.uint8)
