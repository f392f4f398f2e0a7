"""Tracks the head by a particle filter on skin colour and the depth of the face (Hecht et al. 2009, sec. III), and
finds the start: stature, heading and first pose. Host side.
"""

from dataclasses import dataclass, field, replace

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.compile.executable import program
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.trackers.flexible.cylinders import surface_distance
from voodoo_jax.trackers.flexible.flexible_body import FlexibleBody
from voodoo_jax.trackers.flexible.image_features import Features, SkinModel, depth_points
from voodoo_jax.trackers.flexible.vectors import vectors

FACE = (0.045, 0.055)  # half width and height of the face, shares of stature, measured on rendered people
BEHIND = 0.05  # distance of the head point behind the face's skin, share of stature: measured on rendered people
HEAD_HEIGHT = 0.907  # height of the head point, share of stature: measured on the built-in body
_CROWN = 0.115  # points closer to the top, share of stature, belong to the head: measured on rendered people
# points closer to the axis below the head, share of stature, are clothed. Measured: 0.12 and 0.08 instead are 0.06 and
# 0.3 cm worse, in a kick 1.0 and 1.6
_TRUNK, _LEGS = 0.08, 0.12
_UNSEEN = 1.014  # stature over the height of the highest stereo points: hair has no texture; measured on four people
# a box is a face if its share of skin exceeds the share around it by this: fitted, experiments/numbers: 0 is 1.7 cm
# worse, 0.37 is 0.4 cm worse
_SURE = 0.25
# of the particles' weights, and their spread in pixels; measured: 9 and 21, 3.3 and 7.5 are 0.1 to 0.4 cm worse
_SHARPNESS, _NOISE = 14.0, 5.0
_STRAY = 0.03  # share of clothes with colours of skin: measured, trunks in 13 logs of experiments/stereo (median)
_BORDER = 3  # pixels around the face that OpenCV reads for corners: three windows of three; more gives the same
_VELOCITY = 0.5  # share of the last motion that persists, as for limbs in the paper


@dataclass(frozen=True)
class Start:
    """The start found in the first frame with a person."""

    stature: float  # metres
    head: Float32[np.ndarray, "3"]  # of the head point, metres
    left: Float32[np.ndarray, "3"]  # level unit vector from the right to the left shoulder
    face_seen: bool


def find_start(
    f: Features, points: Float32[np.ndarray, "point 3"], floor: Plane, skin: SkinModel, stature: float = 0.0
) -> Start:
    """Finds stature (from the highest points above the floor), head and facing; `skin` learns the colours of the face.

    **Arguments:** `points` on the person, metres; `stature` metres, 0: measured.
    """
    height = floor.height(points)
    top = float(np.percentile(height, 99.5))
    stature = stature or _UNSEEN * top
    up = floor.normal
    crown = points[height > top - _CROWN * stature]
    camera = -f.shift @ f.turn
    level = crown - height[height > top - _CROWN * stature][:, None] * up
    centre = np.median(level, 0)
    toward = camera - centre
    toward -= (toward @ up) * up
    toward /= max(float(np.linalg.norm(toward)), 1e-6)
    head = centre + (floor.offset - centre @ up + HEAD_HEIGHT * stature) * up - BEHIND * stature * toward
    seen = _learn_skin(f, floor, skin, centre, top, stature)
    torso = points[(height > 0.60 * stature) & (height < 0.82 * stature)]
    flat = (torso - torso.mean(0)) - ((torso - torso.mean(0)) @ up)[:, None] * up if len(torso) > 10 else np.eye(3)
    axis = np.linalg.svd(flat, full_matrices=False)[2][0]
    left = axis - (axis @ up) * up
    left /= max(float(np.linalg.norm(left)), 1e-6)
    if np.cross(left, up) @ toward < 0:  # the person is taken to face the camera, with a visible face and without
        left = -left
    return Start(float(stature), head.astype(np.float32), left.astype(np.float32), seen)


def _learn_skin(f: Features, floor: Plane, skin: SkinModel, centre: np.ndarray, top: float, stature: float) -> bool:
    """Learns skin colour from the middle of the head below its top, and clothes from trunk (without arms) and legs.
    Returns whether a face was seen.

    **Arguments:** `centre` of the head, levelled; `top` its height; metres.
    """
    points, at = depth_points(f)
    height, up = floor.height(points), floor.normal
    off = points - centre
    aside, below = np.linalg.norm(off - (off @ up)[:, None] * up, axis=1) / stature, (top - height) / stature
    up_to = height / stature
    trunk = (aside < _TRUNK) & (up_to > 0.55) & (up_to < 0.80)
    legs = (aside < _LEGS) & (up_to > 0.10) & (up_to < 0.38)
    face, clothes = (np.zeros(f.depth.size, bool) for _ in range(2))
    face[at[(aside < 0.045) & (below > 0.055) & (below < _CROWN)]] = True
    clothes[at[trunk | legs]] = True
    face, clothes = face.reshape(f.depth.shape), clothes.reshape(f.depth.shape)
    if face.sum() < 12:
        return False
    skin.learn(f.cell, face, clothes)
    return bool(skin.map(f.cell)[face].mean() > 0.5)


def first_pose(
    rest: Float[np.ndarray, "16 3"], begin: Start, up: Float[np.ndarray, "3"]
) -> Float32[np.ndarray, "16 3"]:
    """The resting body at the measured head, in the person's facing, with the arms slightly out."""
    x = rest.astype(float).copy()
    for root, rows, side in ((2, [3, 4], 1), (5, [6, 7], -1)):
        turn = Rotation.from_euler("x", 12 * side, degrees=True)  # people hold them 15 to 20 degrees out
        x[rows] = turn.apply(x[rows] - x[root]) + x[root]
    frame = np.stack([np.cross(begin.left, up), begin.left, up])
    return ((x - x[0]) @ frame + begin.head).astype(np.float32)


@program
def nearest_parts(
    model: FlexibleBody, x: Float[Array, "16 3"], points: Float[Array, "point 3"]
) -> Int[Array, " point"]:
    """The part of the body in the pose `x` that is nearest to each point."""
    return jnp.argmin(jnp.abs(surface_distance(model, x, vectors(points))), 0)


def with_bare_legs(
    model: FlexibleBody, x: Float32[np.ndarray, "16 3"], points: Float32[np.ndarray, "point 3"],
    share: Float32[np.ndarray, "point"], bare: Float32[np.ndarray, "point"],
) -> FlexibleBody:  # fmt: skip
    """The body with legs that are covered as little as a frame shows in the pose `x`: the logarithm of the share of
    skin on them, as a share of that on the face. Both legs alike. See `chosen_points` for the arguments."""
    near = np.asarray(nearest_parts(model, jnp.asarray(x), jnp.asarray(points)))
    seen = lambda *parts: bare[np.isin(near, parts)].sum() / (share[np.isin(near, parts)].sum() + 1)  # noqa: E731
    covered, face = np.array(model.covered), max(seen(12), _STRAY)
    for thigh in range(6, 9):
        covered[[thigh, thigh + 3]] *= np.log(np.clip(seen(thigh, thigh + 3) / face, _STRAY, 1)) / np.log(_STRAY)
    return replace(model, covered=jnp.asarray(covered))


@dataclass
class HeadFilter:
    """Particles (pixels of the features) of the face; each image moves, weighs and resamples them."""

    skin: SkinModel
    stature: float
    count: int
    rng: np.random.Generator
    particles: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))  # from the face to the head point, metres
    depth: float = 0.0  # of the face, metres
    moved: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def begin(self, f: Features, head: Float32[np.ndarray, "3"], face_seen: bool) -> None:
        """Starts the filter at the face of the head point `head` in the first image."""
        q = f.turn @ head + f.shift
        self.depth = float(q[2]) - BEHIND * self.stature
        at = q[:2] / q[2] * f.focal[:2] + f.focal[2:]
        self.particles = at + self.rng.normal(0, _NOISE, (self.count, 2))
        self.offset = np.zeros(3)
        found = self(f) if face_seen else None
        if found is not None:
            self.offset = (head - found).astype(float)

    def __call__(self, f: Features) -> Float32[np.ndarray, "3"] | None:
        """The head point in this image, metres in the fixed frame; None if no face is seen."""
        skin = self.skin.map(f.cell)
        total = cv2.integral(skin)
        p = self.particles + _VELOCITY * self.moved + self.rng.normal(0, _NOISE, self.particles.shape)
        half = np.array(FACE) * self.stature * f.focal[0] / max(self.depth, 0.3)
        inside, around = _average_in_boxes(total, p, half), _average_in_boxes(total, p, 2 * half)
        score = inside - (4 * around - inside) / 3
        weight = np.exp(_SHARPNESS * (score - score.max()))
        weight /= weight.sum()
        mean = weight @ p
        places = (np.arange(self.count) + self.rng.uniform()) / self.count
        chosen = p[np.searchsorted(np.cumsum(weight), places).clip(0, self.count - 1)]
        if weight @ score < _SURE:
            self.moved = np.zeros(2)
            return None
        z = self._measure_face_depth(f, skin, mean, half)
        self.moved = np.clip(mean - self.particles.mean(0), -12, 12)
        self.particles = chosen
        if z is None:
            return None
        self.depth = z
        at = np.append((mean - f.focal[2:]) / f.focal[:2], 1.0)
        place = at * z + at / np.linalg.norm(at) * BEHIND * self.stature
        return (((place - f.shift) @ f.turn) + self.offset).astype(np.float32)

    def follow(self, f: Features, head: Float32[np.ndarray, "3"]) -> None:
        """Moves the particles to a position of the head found without the face."""
        q = f.turn @ head + f.shift
        at = q[:2] / max(float(q[2]), 0.3) * f.focal[:2] + f.focal[2:]
        self.depth, self.moved = float(q[2]), np.zeros(2)
        self.particles = at + self.rng.normal(0, 2 * _NOISE, (self.count, 2))

    def _measure_face_depth(self, f: Features, skin: np.ndarray, at: np.ndarray, half: np.ndarray) -> float | None:
        if f.pair.size:
            return face_depth(f, at, half, self.depth)
        z = _crop(f.depth, at, half)
        good = (z > 0) & (_crop(skin, at, half) > 0.4) & (np.abs(z - self.depth) < 0.5)
        return float(np.median(z[good])) if good.sum() >= 5 else None


def _crop(image: np.ndarray, at: np.ndarray, half: np.ndarray) -> np.ndarray:
    """The part of an image within a box."""
    low, high = np.round(at - half).astype(int), np.round(at + half).astype(int) + 1
    return image[max(low[1], 0) : max(high[1], 0), max(low[0], 0) : max(high[0], 0)]


def _average_in_boxes(total: np.ndarray, p: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Mean of an image within boxes, from its integral; pixels outside of the image count as 0."""
    rows, columns = total.shape[0] - 1, total.shape[1] - 1
    low, high = np.round(p - half).astype(int), np.round(p + half).astype(int) + 1
    u0, u1 = np.clip(low[:, 0], 0, columns), np.clip(high[:, 0], 0, columns)
    v0, v1 = np.clip(low[:, 1], 0, rows), np.clip(high[:, 1], 0, rows)
    inside = total[v1, u1] - total[v0, u1] - total[v1, u0] + total[v0, u0]
    return inside / np.maximum((high - low).prod(1), 1)


def face_depth(f: Features, at: np.ndarray, half: np.ndarray, near: float) -> float | None:
    """Depth of the face by stereo correspondences of its corners alone, metres; None with too few corners.

    **Arguments:** `at`, `half` the face's box, pixels of the features; `near` its approximate depth, metres.
    """
    left, right = f.pair
    scale = left.shape[1] / f.colour.shape[1]
    low, high = (np.round((at + side * half) * scale).astype(int) for side in (-1, 1))
    u0, v0 = np.maximum(low - _BORDER, 0).tolist()
    u1, v1 = np.maximum(high + _BORDER, 0).tolist()
    mask = np.zeros(left.shape, np.uint8)[v0:v1, u0:u1]
    mask[max(low[1], 0) - v0 : max(high[1], 0) - v0, max(low[0], 0) - u0 : max(high[0], 0) - u0] = 255
    corners = cv2.goodFeaturesToTrack(left[v0:v1, u0:u1], 24, 0.02, 3, mask=mask) if mask.size else None
    if corners is None:
        return None
    (reach, shift), block, found = f.rig.tolist(), 6, []
    middle = reach / near - shift
    slack = int(np.ceil(reach / max(near - 0.4, 0.3) - reach / near)) + 3
    for u, v in np.round(corners[:, 0]).astype(int) + (u0, v0):
        patch = left[v - block : v + block + 1, u - block : u + block + 1]
        begin = int(u - middle) - slack - block
        strip = right[v - block : v + block + 1, max(begin, 0) : max(int(u - middle) + slack + block + 1, 0)]
        if patch.shape != (2 * block + 1,) * 2 or begin < 0 or strip.shape[1] <= patch.shape[1]:
            continue
        match = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)[0]
        best = int(match.argmax())
        if match[best] < 0.7 or not 0 < best < len(match) - 1:
            continue
        a, b, c = match[best - 1 : best + 2]
        peak = best + 0.5 * (a - c) / min(a - 2 * b + c, -1e-6)
        found.append(u - (begin + block + peak) + shift)
    d = np.array(found)
    return float(reach / np.median(d)) if len(d) >= 4 and np.median(d) > 0.5 else None
