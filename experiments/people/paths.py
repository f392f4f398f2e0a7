"""How a camera moves that looks at somebody: with a robot, round the person, about itself, in a hand."""

from dataclasses import replace

import numpy as np

from experiments.common import slow_noise
from experiments.people.motions import eased
from voodoo_jax.simulate.sensor import Camera

PATHS = ("drives up", "goes round", "turns", "in a hand")
LOOKS = 15  # frames before and after, over whose mean somebody is looked at
HAND = (0.03, 0.02, 0.03)  # standard deviations in a hand: metres, radians of pitch and of yaw
SLOW = 9  # frames over which that changes


def moved(camera: Camera, path: str, middle: np.ndarray, rng: np.random.Generator) -> list[Camera]:
    """The camera in each frame. `middle` [frame, 3] is where somebody is then, in the fixed frame."""
    count = len(middle)
    seen = np.array([middle[max(0, i - LOOKS) : i + LOOKS + 1].mean(0) for i in range(count)])
    share = np.linspace(0, 1, count)
    place = np.tile(np.array(camera.position, float), (count, 1))
    pitch, yaw = np.full(count, camera.pitch), np.zeros(count)
    if path == "drives up":
        place[:, 0] += eased(share) - 1
        place[:, 1] += 0.3 * np.sin(3 * share)
    elif path == "goes round":
        whole, angle = seen.mean(0), 1.2 * (eased(share) - 0.5)
        away = np.linalg.norm(whole[:2] - place[0, :2])
        place[:, 0] = whole[0] - away * np.cos(angle)
        place[:, 1] = whole[1] - away * np.sin(angle)
    elif path == "turns":
        yaw = 0.16 * np.sin(3 * np.pi * share)
    elif path == "in a hand":
        place += HAND[0] * np.stack([slow_noise(rng, count, SLOW, 3 * SLOW) for _ in range(3)], 1)
        pitch = pitch + HAND[1] * slow_noise(rng, count, SLOW, 3 * SLOW)
        yaw = HAND[2] * slow_noise(rng, count, SLOW, 3 * SLOW)
    if path in PATHS[:2]:
        yaw = np.arctan2(seen[:, 1] - place[:, 1], seen[:, 0] - place[:, 0])
    return [
        replace(camera, position=(float(x), float(y), float(z)), pitch=float(p), yaw=float(w))
        for (x, y, z), p, w in zip(place, pitch, yaw)
    ]
