"""Somebody made of capsules who leans to and fro, a box beside their legs, as rays of trimesh meet them."""

import numpy as np
import trimesh

from tests.support.rooms import ORIGIN
from voodoo_jax.records.observation import BodyObservation

BOX = trimesh.creation.box((0.45, 0.5, 0.45))
BOX.apply_transform(trimesh.transformations.rotation_matrix(0.75, [0, 0, 1]))
BOX.apply_translation([3.25, 0.43, 0.225])


def capsule(low, high, radius: float) -> trimesh.Trimesh:
    """One between two places."""
    made = trimesh.creation.capsule(float(np.linalg.norm(np.subtract(high, low))), radius, count=(16, 16))
    made.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], np.subtract(high, low)))
    made.apply_translation(low)
    return made


def somebody(lean: float) -> trimesh.Trimesh:
    """Stands before the box."""
    legs = [capsule([2.9, y, 0.08], [2.9, y, 0.85], 0.08) for y in (-0.1, 0.1)]
    trunk = capsule([2.9, 0, 0.95], [2.9, lean, 1.4], 0.17)
    head = trimesh.creation.icosphere(2, 0.11)
    head.apply_translation([2.9, 1.3 * lean, 1.65])
    return trimesh.util.concatenate([*legs, trunk, head])


def seen(
    rng, count: int = 45, noise: float = 0.015, with_box: bool = True
) -> tuple[list[BodyObservation], list[np.ndarray]]:
    """Frames from a camera that stands still, and which points of each are on the box."""
    up, across = (a.ravel() for a in np.meshgrid(np.arange(-0.42, 0.2, 0.011), np.arange(-0.17, 0.27, 0.011)))
    rays = np.stack([np.ones_like(up), across, up], 1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    views = []
    for lean in 0.2 * np.sin(np.linspace(0, 2 * np.pi, 9, endpoint=False)):
        parts = [somebody(lean), *([BOX] if with_box else [])]
        mesh = trimesh.util.concatenate(parts)
        places, ray, face = mesh.ray.intersects_location(np.repeat(ORIGIN, len(rays), 0), rays, multiple_hits=False)
        views.append((ray, np.linalg.norm(places - ORIGIN, axis=1), face >= len(parts[0].faces)))
    frames, on_box = [], []
    for k in range(count):
        ray, distance, box = views[k % len(views)]
        distance = distance + rng.normal(0, noise, len(ray))
        points = (ORIGIN + rays[ray] * distance[:, None]).astype(np.float32)
        frames.append(BodyObservation(k * 33_000_000, points, np.zeros(len(ray), np.int32), ORIGIN, noise=noise))
        on_box.append(box)
    return frames, on_box
