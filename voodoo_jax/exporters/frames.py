"""Shared by exporters and pictures: the upward direction, frames at an even rate, some frames, and those that count."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.records.tracks import Status, Tracks

# rows: axes of a file in a frame with z up, x forwards and y to the left
Z_UP = np.eye(3)
OPENSIM = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # x forwards, y up, z to the right
ANIMATION = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # x to the left, y up, z forwards
ALONG_AXIS = np.cos(np.radians(3))  # so near to an axis of the fixed frame upwards is that axis
JITTER = 0.25  # share of a frame's time by which stamps may be off an even rate
LONGEST = 10_000_000  # frames: four days at 30 Hz
GAP = 3.0  # frames: poses are not interpolated over longer gaps


def upright(tracks: Tracks) -> Float[np.ndarray, "3 3"]:
    """Rotation from the tracks' fixed frame to one with z up: the identity if its z is up already, as in ROS (REP
    103)."""
    up = np.array([0.0, 0, 1]) if tracks.up is None else np.asarray(tracks.up, float)
    up = up / np.linalg.norm(up)
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > ALONG_AXIS:
        up = np.sign(up[axis]) * np.eye(3)[axis]
    if up[2] < -0.999:  # upside down: any half turn
        return np.diag([1.0, -1, -1])
    turn = np.cross(up, [0.0, 0, 1])
    angle = np.arctan2(np.linalg.norm(turn), up[2])
    length = np.linalg.norm(turn)
    return Rotation.from_rotvec(turn * (angle / length if length else 0.0)).as_matrix()


def seconds(tracks: Tracks) -> Float[np.ndarray, " frame"]:
    """Time of each frame since the first one, seconds."""
    stamps = np.asarray(tracks.time_ns, np.int64)
    return (stamps - stamps[:1]) / 1e9


def usual_rate(tracks: Tracks) -> float:
    """Frames per second of most frames; 30 for fewer than two frames."""
    steps = np.diff(seconds(tracks))
    steps = steps[steps > 0]
    return float(1 / np.median(steps)) if len(steps) else 30.0


def known(tracks: Tracks) -> Bool[np.ndarray, "frame limb"]:
    """Limbs with a pose to be written: finite, in tracked frames."""
    finite = np.isfinite(tracks.rotation).all(2) & np.isfinite(tracks.translation).all(2)
    return finite & tracks.tracked[:, None]


def forwards(tracks: Tracks, i: int) -> Float[np.ndarray, "3"] | None:
    """Where the body's front points in a frame, in the fixed frame; None without a pose."""
    root = tracks.rotation[i, 0]
    if not np.isfinite(root).all():
        return None
    rest = np.asarray(tracks.body.rest.rotation, float)[0]
    return (rotations(root) * rotations(rest).inv()).apply([1.0, 0, 0])[0]  # x in its rest pose


def joints(tracks: Tracks) -> Float[np.ndarray, "frame joint 3"]:
    """Joint centres in the fixed frame, metres; NaN in frames that are not tracked."""
    return np.where(tracks.tracked[:, None, None], tracks.joints, np.nan).astype(float)


def landmarks(tracks: Tracks) -> Float[np.ndarray, "frame site 3"]:
    """The body's feature points in the fixed frame, metres; NaN where their limb has no pose."""
    limbs = np.array(tracks.body.topology.site_limbs, int)
    turn = rotations(tracks.rotation[:, limbs])
    local = np.tile(np.asarray(tracks.body.sites, float), (len(tracks.time_ns), 1, 1))
    at = turn.apply(local.reshape(-1, 3)).reshape(local.shape) + tracks.translation[:, limbs]
    return np.where(known(tracks)[:, limbs, None], at, np.nan)


def evenly(tracks: Tracks) -> tuple[Tracks, float]:
    """Tracks at an even rate, and frames a second, for formats that have no time for each frame.

    Frames are as they are where their stamps are off an even rate by less than a quarter of a frame. Otherwise poses
    are interpolated at the usual rate; in longer gaps nothing is tracked.
    """
    time = seconds(tracks)
    if len(time) < 2:
        return tracks, usual_rate(tracks)
    period = 1 / usual_rate(tracks)
    count = int(round(time[-1] / period)) + 1
    even = np.linspace(0, time[-1], len(time))
    if count == len(time) and np.abs(time - even).max() <= JITTER * period:
        return tracks, (len(time) - 1) / float(time[-1])
    if count > LONGEST:
        raise ValueError(
            f"{len(time)} frames in {time[-1]:.0f} s would be {count} at their rate of {1 / period:.3g} Hz"
        )
    return _resampled(tracks, time, period * np.arange(count), period), 1 / period


def _resampled(tracks: Tracks, time: np.ndarray, wanted: np.ndarray, usual: float) -> Tracks:
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    before = after - 1
    step = time[after] - time[before]
    share = np.clip((wanted - time[before]) / np.where(step > 0, step, 1), 0, 1)
    nearest = np.where(share < 0.5, before, after)
    within = (step <= GAP * usual) | (np.abs(time[nearest] - wanted) <= 0.5 * usual)

    def between(values: np.ndarray, signed: bool = False) -> np.ndarray:
        a, b = values[before].astype(float), values[after].astype(float)
        if signed:  # quaternions of either sign are one rotation
            b = b * np.where((a * b).sum(-1, keepdims=True) < 0, -1, 1)
        w = share.reshape(-1, *[1] * (values.ndim - 1))
        # a neighbour without pose says nothing where the other one is taken as it is
        mixed = np.where(w == 0, a, np.where(w == 1, b, (1 - w) * a + w * b))
        return np.where(within.reshape(w.shape), mixed, np.nan)

    turn = between(tracks.rotation, signed=True)
    norm = np.linalg.norm(turn, axis=-1, keepdims=True)
    both = tracks.tracked[before] & tracks.tracked[after]
    alone = tracks.tracked[nearest] & ((share == 0) | (share == 1))
    return tracks.only(nearest).having(
        time_ns=tracks.time_ns[0] + np.round(wanted * 1e9).astype(np.int64),
        rotation=(turn / np.where(norm > 0, norm, 1)).astype(np.float32),
        translation=between(tracks.translation).astype(np.float32),
        joints=between(tracks.joints).astype(np.float32),
        status=np.where((both | alone) & within, Status.TRACKED, Status.LOST).astype(np.int8),
    )
