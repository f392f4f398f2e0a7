"""Detects reflections of people in a plane, such as a mirror, a window at night or a polished wall. Host side, NumPy.

A reflection repeats the motion of a person. The person's body, reflected in one fixed plane, explains the reflection's
points about as well as a body fitted to them, but not with the poses of other times.
"""

from itertools import permutations

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Subject
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.icp.misfit import AROUND, body_distance
from voodoo_jax.trackers.shared.runner import FEW_POINTS

LOOKED_AT, POINTS = 12, 50  # frames in which two people are compared, and points of each; by hand
# times the distance (rms) of points from their own body that they are from the reflected one. Measured: of images 0.9
# to 1.3, of people who do the same 1.7 and more; and at other times so many times more: 1.8 and more, 1.5 at most
ALIKE = 1.5
NEAR = 0.02  # metres: farther points count less, about the depth cameras' noise and a body's misfit; by hand
IMAGE = (
    "What looked like another person is this one's image in a plane {:.1f} m away, such as a mirror or a window: it is "
    "left out."
)


def reflected(subjects: list[Subject], found: list[Tracks]) -> dict[int, tuple[int, float]]:
    """People who are images of others: indices of an image and of its person, and how far this one is from the plane,
    metres."""
    images: dict[int, tuple[int, float]] = {}
    for image, person in permutations(range(len(found)), 2):
        if image not in images and person not in images:
            if away := _distance_of_plane(found[person], found[image], subjects[image].frames):
                images[image] = person, away
    return images


def _distance_of_plane(person: Tracks, image: Tracks, frames: list[BodyObservation]) -> float:
    """Distance of a person from the plane that reflects them, metres; 0 if `image` is not their reflection.

    **Arguments:** `frames` with the points of the `image`.
    """
    seen = np.array([len(f.points) >= 3 * FEW_POINTS for f in frames], bool)
    both = np.flatnonzero(seen & person.tracked & image.tracked)
    at = both[:: len(both) // LOOKED_AT + 1]
    if len(at) < 2:
        return 0.0
    points = [_some(frames[k]) for k in at]
    own = _rms(_distances(image, at, points))
    one, other = (np.nanmean(t.joints[at], (0, 1)).astype(float) for t in (person, image))
    middle, (_, *across) = (one + other) / 2, np.linalg.svd((other - one)[None])[2]
    normal = (other - one) / max(np.linalg.norm(other - one), 1e-6)

    def plane(x: np.ndarray) -> tuple[np.ndarray, float]:
        """A normal and its product with the plane's points: ones are the plane between the middles of the two."""
        turned = normal + (x[:2] - 1) @ across
        turned /= np.linalg.norm(turned)
        return turned, turned @ middle + x[2] - 1

    def off(x: np.ndarray, at=at) -> np.ndarray:
        n, offset = plane(x)
        return _distances(person, at, [p - 2 * (p @ n - offset)[:, None] * n for p in points])

    x = np.ones(3)
    if _rms(off(x)) > ALIKE**2 * own:
        return 0.0
    x = least_squares(off, x, loss="soft_l1", f_scale=NEAR, diff_step=1e-3, max_nfev=5).x
    n, offset = plane(x)
    before = np.all((frames[at[0]].origins @ n - offset) * (one @ n - offset) > 0)
    now, then = _rms(off(x)), _rms(off(x, np.roll(at, len(at) // 2)))
    return float(abs(one @ n - offset)) if before and now < ALIKE * own and then > ALIKE * now else 0.0


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _some(frame: BodyObservation) -> Float[np.ndarray, "some 3"]:
    """Points of a frame, evenly taken, in the fixed frame."""
    points = frame.points[:: len(frame.points) // POINTS + 1].astype(float)
    T = frame.T_fixed_steady
    return points if T is None else points @ T[:3, :3].T + T[:3, 3]


def _distances(tracks: Tracks, at: np.ndarray, points: list[np.ndarray]) -> Float[np.ndarray, " point"]:
    """Distances of the points of frames from a body's surface in these, metres."""
    sizes = np.asarray(tracks.body.sizes, np.float32)
    poses = zip(tracks.rotation[at], tracks.translation[at])
    return np.concatenate([body_distance(sizes, *pose, p.astype(np.float32), AROUND) for pose, p in zip(poses, points)])
