"""What a learned eye sees of a person in one frame: where to start from, and which way they face.

Host side, but for the net (kernels/eye.py). The weights are described in eye.md.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import Rotation

from voodoo_jax.compile.executable import program
from voodoo_jax.geometry.arrays_file import arrays_in
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.eye import HIGH, JOINTS, LEFT, OTHER, PARTS, RIGHT, Params, ahead, forward, named
from voodoo_jax.markers.first_pose import first_poses
from voodoo_jax.model.body import Body
from voodoo_jax.records.observation import BodyObservation

# voxels, and numbers of each, that the net takes; size, lowest height and farthest distance from the column, metres;
# cells along x, y and z: the weights hold for these alone, see experiments/eye
TOKENS, FEATURES, VOXEL, LOW, RADIUS = 64, 18, 0.18, -0.12, 1.1
GRID = np.array([13, 13, 14])  # as in experiments/eye
FLOOR, THIN = 0.02, 0.03  # metres above the floor, and between points, of what it is asked of: as in experiments/eye
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # of a covariance, as in experiments/eye
# looks at most, each about the hips that the one before has found, if these are farther off; metres; measured there
LOOKS, NEAR = 2, 0.05
SURE = 0.3  # metres of own error: joints with more do not count; measured, experiments/eye


class Seen(NamedTuple):
    """A person in one frame."""

    joints: Float[np.ndarray, "joint 3"]  # metres, fixed frame; in the order of kernels.eye.JOINTS
    spread: Float[np.ndarray, " joint"]  # their error, metres
    front: Float[np.ndarray, "3"]  # where the trunk faces, as long as the logarithm of the odds of that
    own: Float[np.ndarray, " point"]  # probability that each of the frame's points is theirs

    @property
    def exchanged(self) -> "Seen":
        """The person with left and right exchanged: the eye takes a front for a back sometimes."""
        return Seen(self.joints[OTHER], self.spread[OTHER], -self.front, self.own)


OWN = Path(__file__).with_name("eye.npz")


@cache
def weights(path: Path = OWN) -> Params:
    """The weights of a net in a file."""
    with path.open("rb") as file:
        return {name: value.astype(np.float32) for name, value in arrays_in(file).items()}


@program
def predict(
    p: Params, tok: Float[Array, "token feature"], sensor: Float[Array, "2"]
) -> tuple[Array, Array, Array, Array]:
    """Joints, logarithm of their error, direction in which the trunk faces, as long as the logarithm of the odds of
    that, in the frame of the view; probability that each voxel is on the person."""
    said, odds = named(forward(p, tok, sensor))
    own = jax.nn.softmax(said.part)[:, :PARTS].sum(-1)
    return said.joints, said.spread, odds * ahead(said.joints), own


def prepare(body: Body) -> None:
    """Compiles or loads the net, for a person."""
    if body.scale_name == "stature":
        predict.prepare(weights(), np.zeros((TOKENS, FEATURES), np.float32), np.zeros(2, np.float32))


def seen(frame: BodyObservation, floor: Plane) -> Seen | None:
    """The person whose points these are; None without points above the floor."""
    above, up = floor.height(frame.points) > FLOOR, floor.normal.astype(float)
    points, own = frame.points[above].astype(float), above.astype(float)
    if not len(points):
        return None
    sensor = frame.origins[int(np.bincount(frame.sensor).argmax())].astype(float)
    column, looks = np.median(points, 0), LOOKS
    while True:
        foot = column - (column @ up - floor.offset) * up
        turn = view(sensor - foot, up)
        (at, thin), eye = thinned((points - foot) @ turn.T), (sensor - foot) @ turn.T
        far, (voxels, which) = np.array([np.hypot(*eye[:2]), eye[2]], np.float32), tokens(at)
        joints, spread, front, share = map(np.asarray, predict(weights(), voxels, far))
        hips, looks = joints[[LEFT[1], RIGHT[1]], :2].mean(0), looks - 1
        if looks == 0 or np.linalg.norm(hips) < NEAR:
            own[above] = np.append(share, 0.0)[which[thin]]  # farther off than all voxels: nothing of theirs
            return Seen(joints @ turn + foot, np.exp(spread), front @ turn, own)
        column = foot + hips @ turn[:2]


def view(sensor: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The turn into the frame of the view: z up, the sensor, as it is from the origin, towards +x."""
    level = sensor - (sensor @ up) * up
    x = level if np.linalg.norm(level) > 1e-6 else np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def thinned(
    points: Float[np.ndarray, "point 3"],
) -> tuple[Float[np.ndarray, "some 3"], Int[np.ndarray, " point"]]:
    """One point in each small voxel, and which one is in that of each point."""
    key = np.floor(points / THIN).astype(np.int64) @ [4096**2, 4096, 1]
    _, first, which = np.unique(key, return_index=True, return_inverse=True)
    return points[first], which


def tokens(
    points: Float[np.ndarray, "point 3"],
) -> tuple[Float[np.ndarray, "token feature"], Int[np.ndarray, " point"]]:
    """Voxels of points about a column in the frame of the view, the nearest to the axis first: mean, covariance,
    octants, number of points; and the voxel of each point, -1 of those that are in none."""
    corner, lattice = np.array([GRID[0] / 2, GRID[1] / 2, -LOW / VOXEL]), points / VOXEL
    cell = np.floor(lattice + corner).astype(int)
    inside = (np.hypot(points[:, 0], points[:, 1]) <= RADIUS) & (points[:, 2] <= HIGH)
    near = np.flatnonzero(inside & np.all((cell >= 0) & (cell < GRID), 1))
    some, octant = points[near], (lattice[near] + corner - cell[near] > 0.5) @ [4, 2, 1]
    _, which, count = np.unique(cell[near] @ [GRID[1] * GRID[2], GRID[2], 1], return_inverse=True, return_counts=True)
    mean, square = (
        np.stack([np.bincount(which, v, len(count)) for v in values], -1) / count[:, None]
        for values in (some.T, [some[:, i] * some[:, j] for i, j in PAIRS])
    )
    spread = square - np.stack([mean[:, i] * mean[:, j] for i, j in PAIRS], -1)
    share = np.bincount(8 * which + octant, minlength=8 * len(count)).reshape(-1, 8) / count[:, None]
    away = np.hypot(mean[:, 0], mean[:, 1]) - 0.01 * np.minimum(count, 9)
    kept = np.argsort(away, kind="stable")[:TOKENS]
    made = np.zeros((TOKENS, FEATURES), np.float32)
    made[: len(kept)] = np.column_stack([mean, 400 * spread, share, count / 9])[kept]
    place, at = np.full(len(count), -1), np.full(len(points), -1)
    place[kept] = np.arange(len(kept))
    at[near] = place[which]
    return made, at


def poses_of(body: Body, person: Seen) -> Poses | None:
    """The body with its joints where they are seen; None for a body without these joints."""
    names, centres = body.topology.centres, len(body.topology.site_limbs)
    known = np.array([name in names for name in JOINTS])
    rows = np.array([centres + names.index(name) if name in names else 0 for name in JOINTS])
    use = known & (person.spread < SURE)
    if use.sum() < 6:
        return None
    turn, at, _ = first_poses(body, rows, person.joints[None], use[None], scaled_by=1.0)
    q = Rotation.from_matrix(turn[0]).as_quat(scalar_first=True)
    return Poses(q.astype(np.float32), at[0].astype(np.float32))
