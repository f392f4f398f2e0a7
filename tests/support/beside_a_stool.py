"""A body at rest that a stool touches."""

import numpy as np

from tests.support.helpers import seen_points
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.records.observation import BodyObservation

BODY, COUNT, OF_BODY = scaled(human(), 1.7), 40, 1500  # frames, and points on the body in each, the first ones
SENSOR = np.array([[3.0, 0.0, 1.2]], np.float32)
STOOL = np.array([0.15, 0.3, 0.2])  # the middle of a round thing that touches a leg


def frames(rng, stool: int = 300) -> list[BodyObservation]:
    """The body in the rest pose, and so many points of the stool, always in the same directions."""
    ball = rng.normal(size=(4 * stool, 3))
    ball = (STOOL + 0.2 * ball / np.linalg.norm(ball, axis=1, keepdims=True))[ball[:, 0] > 0][:stool]
    points = np.concatenate([seen_points(rng, BODY, BODY.rest, SENSOR[0], OF_BODY), ball])
    rays = points - SENSOR
    distance = np.linalg.norm(rays, axis=1, keepdims=True)
    out = []
    for k in range(COUNT):
        noisy = (SENSOR + rays * (1 + rng.normal(0, 0.008, distance.shape) / distance)).astype(np.float32)
        out.append(BodyObservation(k * 33_000_000, noisy, np.zeros(len(noisy), np.int32), SENSOR, noise=0.008))
    return out
