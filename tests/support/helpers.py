"""Oracles and small worlds for tests: meshes of limbs, random poses, what a sensor sees of a body, differences."""

import time
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from voodoo_jax.config.options import SolveSettings, TrackSettings
from voodoo_jax.geometry.rigid import Poses, compose, quat_exp
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.solve.pulls import IcpOptions
from voodoo_jax.solve.scan import options_from

TWO_LIMBS_SENSOR = np.array([[2.0, 0.4, 0.5]], np.float32)  # sees two_limb_frames
# settings are being tuned elsewhere: the tests state their own
SOLVE = SolveSettings(
    max_steps=30, epsilon=1e-8, ratio=0.6, floor=0.03, body_enlarge=0.4, limb_enlarge=0.2, max_distance=0.2,
    robust_scale=0.1, overlap="exclusive", near_side=True, refine=0, prior=0.001, prior_radius=0.4, steady=0.0,
    solver="coupled", damping=1e-4,
)  # fmt: skip


def wait_for(what, seconds: float = 120.0) -> None:
    """Waits until `what()` is true."""
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def cast(tree, dtype):
    """The same tree with all floating point arrays in another precision."""
    change = lambda x: jnp.asarray(x, dtype) if jnp.issubdtype(jnp.result_type(x), jnp.floating) else x  # noqa: E731
    return jax.tree.map(change, tree)


def icp_options(dtype=jnp.float32, **changes) -> IcpOptions:
    """Options of one frame's solve, in the given precision."""
    return cast(options_from(replace(SOLVE, **changes), TrackSettings()).icp, dtype)


def random_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """[count, 4] unit quaternions wxyz, uniform."""
    return Rotation.random(count, rng=rng).as_quat(scalar_first=True)


def scipy_rotation(q) -> Rotation:
    """A rotation of the independent library from wxyz."""
    return Rotation.from_quat(np.asarray(q, np.float64), scalar_first=True)


def turned(rng: np.random.Generator, poses: Poses, metres: float, degrees: float) -> Poses:
    """Every limb moved and turned by exactly so much in a random direction."""
    shape = np.shape(poses.translation)
    shift, axis = rng.normal(size=shape), rng.normal(size=shape)
    shift *= metres / np.linalg.norm(shift, axis=-1, keepdims=True)
    axis *= np.radians(degrees) / np.linalg.norm(axis, axis=-1, keepdims=True)
    dtype = poses.translation.dtype
    moved = compose(poses, Poses(quat_exp(jnp.asarray(axis, dtype)), jnp.zeros(shape, dtype)))
    return Poses(moved.rotation, moved.translation + jnp.asarray(shift, dtype))


def frustum_mesh(size, around: int = 256, along: int = 8) -> trimesh.Trimesh:
    """Closed mesh of a degenerated cylinder: dense enough to err by less than 0.02 mm for limbs of 10 cm."""
    a0, b0, a1, b1, length = np.asarray(size, np.float64)
    s, t = np.meshgrid(np.linspace(0, 1, along + 1), np.arange(around) * 2 * np.pi / around, indexing="ij")
    side = np.stack([(a0 + s * (a1 - a0)) * np.cos(t), (b0 + s * (b1 - b0)) * np.sin(t), s * length], -1)
    vertices = np.concatenate([side.reshape(-1, 3), [[0, 0, 0], [0, 0, length]]])
    here = (np.arange(along)[:, None] * around + np.arange(around)).ravel()
    right = (np.arange(along)[:, None] * around + (np.arange(around) + 1) % around).ravel()
    ring, following = np.arange(around), (np.arange(around) + 1) % around
    last, middle = along * around, np.full(around, len(vertices) - 2)
    faces = [
        np.stack([here, right, right + around], -1), np.stack([here, right + around, here + around], -1),
        np.stack([middle, following, ring], -1), np.stack([middle + 1, last + ring, last + following], -1),
    ]  # fmt: skip
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


def inside_limb(size, local: np.ndarray) -> np.ndarray:
    """Whether points in the limb frame are inside, by the definition of the solid."""
    a0, b0, a1, b1, length = np.asarray(size, np.float64)
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    s = np.clip(z / length, 0, 1)
    return (z > 0) & (z < length) & ((x / (a0 + s * (a1 - a0))) ** 2 + (y / (b0 + s * (b1 - b0))) ** 2 < 1)


def inside_body(body: Body, poses: Poses, points: np.ndarray) -> np.ndarray:
    """Whether points (world frame) are inside any limb."""
    out = np.zeros(points.shape[:-1], bool)
    for limb, size in enumerate(np.asarray(body.sizes)):
        offset = points - np.asarray(poses.translation[limb], np.float64)
        local = scipy_rotation(poses.rotation[limb]).inv().apply(offset.reshape(-1, 3)).reshape(offset.shape)
        out |= inside_limb(size, local)
    return out


def seen_points(rng: np.random.Generator, body: Body, poses: Poses, sensor, count: int) -> np.ndarray:
    """[count, 3] points evenly spread over the part of the surface that a sensor sees, hidden parts left out."""
    sensor = np.asarray(sensor, np.float64)
    meshes = []
    for limb, size in enumerate(np.asarray(body.sizes)):
        mesh = frustum_mesh(size, around=64, along=4)
        transform = np.eye(4)
        transform[:3, :3] = scipy_rotation(poses.rotation[limb]).as_matrix()
        transform[:3, 3] = np.asarray(poses.translation[limb])
        meshes.append(mesh.apply_transform(transform))
    whole = trimesh.util.concatenate(meshes)
    points, faces = trimesh.sample.sample_surface(whole, 12 * count, seed=int(rng.integers(2**31)))
    facing = np.sum((sensor - points) * whole.face_normals[faces], -1) > 0
    points = np.asarray(points)[facing]
    ray = (sensor - points) / np.linalg.norm(sensor - points, axis=-1, keepdims=True)
    # from 4 mm in front of the point (the mesh lies inside the limb) until beyond the body
    steps = np.concatenate([[0.004], np.arange(0.02, 1.0, 0.02)])
    hidden = inside_body(body, poses, points[:, None] + ray[:, None] * steps[:, None]).any(-1)
    visible = points[~hidden]
    assert len(visible) >= count, "too few visible points: sample more"
    return visible[rng.permutation(len(visible))[:count]]


def frame_points(xyz: np.ndarray, origins, dtype=jnp.float32, capacity: int = 0, sensor=None) -> Points:
    """Points of one frame, padded to `capacity` at the first sensor with weight zero."""
    count = max(len(xyz), capacity)
    padded = np.tile(np.asarray(origins, np.float64)[0], (count, 1))
    padded[: len(xyz)] = xyz
    weight = (np.arange(count) < len(xyz)).astype(np.float64)
    of = np.zeros(count, np.int32)
    if sensor is not None:
        of[: len(xyz)] = sensor
    return Points(jnp.asarray(padded, dtype), jnp.asarray(weight, dtype), jnp.asarray(of), jnp.asarray(origins, dtype))


def random_like(rng: np.random.Generator, tree):
    """A random direction: the same structure, normally distributed."""
    return jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape), x.dtype), tree)


def dot(a, b):
    """Scalar product of two trees of arrays."""
    return sum(jnp.sum(x * y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b)))


def central_difference(function, at, direction, step: float):
    """Derivative of `function` at `at` along `direction`, error of second order in `step`."""
    ahead, behind = (jax.tree.map(lambda x, d, sign=sign: x + sign * step * d, at, direction) for sign in (1, -1))
    return jax.tree.map(lambda p, m: (p - m) / (2 * step), function(ahead), function(behind))


def all_finite(tree) -> bool:
    """No NaN and no infinity in any array of a tree."""
    return all(bool(np.all(np.isfinite(x))) for x in jax.tree.leaves(eqx.filter(tree, eqx.is_inexact_array)))


def two_limbs(axes=(0.0, 0.0), weight: float = 1.0) -> Body:
    """Two round limbs in a line along z, joined where they meet: the smallest body with a joint."""
    from voodoo_jax.model.body_file import parse_body

    return parse_body(f"""
name = "two"
scale = 1.0
limb = [
  {{name = "a", bottom = [0, 0, 0], top = [0, 0, 0.4], bottom_axes = [0.05, 0.05], top_axes = [0.05, 0.05]}},
  {{name = "b", bottom = [0, 0, 0.4], top = [0, 0, 0.8], bottom_axes = [0.05, 0.05], top_axes = [0.04, 0.04]}},
]
joint = [{{name = "j", parent = "a", child = "b", at = [0, 0, 0.4], axes = [{axes[0]}, {axes[1]}], weight = {weight}}}]
""")


def two_limb_frames(counts, seed: int = 0) -> list[BodyObservation]:
    """So many points of two_limbs in each of some frames, the first ones of 300 that one sensor sees; 30 Hz."""
    body = two_limbs()
    xyz = seen_points(np.random.default_rng(seed), body, body.rest, TWO_LIMBS_SENSOR[0], 300).astype(np.float32)
    sensor = lambda n: np.zeros(n, np.int32)  # noqa: E731
    return [
        BodyObservation(10**18 + i * 33_000_000, xyz[:n], sensor(n), TWO_LIMBS_SENSOR) for i, n in enumerate(counts)
    ]
