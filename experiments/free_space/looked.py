"""What the rays of a depth camera say about limbs that were tracked. Worker processes import this."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from experiments.common import errors, human, nearest, scored, without_features
from experiments.judged import read
from experiments.stress.changes import changes
from voodoo_jax.body import Body
from voodoo_jax.clouds import point_spacing
from voodoo_jax.recording import Frame
from voodoo_jax.settings import Settings

STATIONS = np.linspace(0.1, 0.9, 5)  # along each limb
MARGIN = 0.1  # metres: what differs by less is noise
NEIGHBOURS = 5  # rays that are asked; the nearest thing that one of them met counts


@dataclass(frozen=True)
class Job:
    """A recording, changed as in experiments.stress, from depth alone."""

    change: str
    log: Path
    frames: int = 0


@dataclass(frozen=True)
class Looked:
    """What is known of joints, one row per joint and frame."""

    error: Float[np.ndarray, " row"]  # metres
    free: Float[np.ndarray, " row"]  # share of the stations of the joint's limb that a ray passes through
    hidden: Float[np.ndarray, " row"]  # share that is behind something
    spread: Float[np.ndarray, " row"]  # what the tracker itself says: root of the covariance's trace, metres


def seen_through(
    body: Body, rotation: Float[np.ndarray, "limb 4"], translation: Float[np.ndarray, "limb 3"], frame: Frame
) -> tuple[Float[np.ndarray, " limb"], Float[np.ndarray, " limb"]]:
    """Shares of each limb's stations, on the side towards the sensor, that rays pass through, and that are hidden.

    A station where no ray is near counts as neither: beyond the picture's edge, or without any depth.
    """
    sizes = np.asarray(body.sizes, float)
    axis = Rotation.from_quat(rotation, scalar_first=True).apply([0.0, 0.0, 1.0])
    radius = sizes[:, :2].min(1)[:, None] * (1 - STATIONS) + sizes[:, 2:4].min(1)[:, None] * STATIONS
    place = translation[:, None] + axis[:, None] * (sizes[:, 4:5] * STATIONS)[..., None]
    free, hidden = np.zeros(radius.shape, bool), np.zeros(radius.shape, bool)
    for sensor, origin in enumerate(frame.origins):
        rays = frame.points[frame.sensor == sensor] - origin
        if len(rays) < NEIGHBOURS:
            continue
        reach = np.linalg.norm(rays, axis=1)
        tree = KDTree(rays / reach[:, None])
        spacing = point_spacing(frame.points[frame.sensor == sensor], origin)
        away = np.linalg.norm(place - origin, axis=-1)
        to = (place - origin) / away[..., None]
        near, which = tree.query(to, k=NEIGHBOURS, distance_upper_bound=1.6 * spacing)
        known = np.isfinite(near).sum(-1) >= 3
        met = np.where(np.isfinite(near), reach[np.minimum(which, len(reach) - 1)], np.inf).min(-1)
        free |= known & (met > away - radius + MARGIN)
        hidden |= known & (met < away - radius - MARGIN)
    return free.mean(1), hidden.mean(1)


def work(job: Job) -> Looked:
    """Tracks, and asks the rays about every joint's limb in every scored frame."""
    recorded = changes(human(), Settings())[job.change](read(job.log, Settings(), job.frames))
    log = recorded.log(human(), Settings())
    tracks = log.track(human(), Settings(), without_features(log.people))
    error, keep = errors(log, tracks), scored(log)
    row, near = nearest(log, tracks)
    shares = [
        seen_through(tracks.body, q, t, f) for q, t, f in zip(tracks.rotation, tracks.translation, recorded.frames)
    ]
    free, hidden = (np.array(x) for x in zip(*shares))
    topology = tracks.body.topology
    mine = [topology.centres.index(name) for name in log.names]
    limb = [topology.centre_limbs[k] for k in mine]
    covariance = tracks.joint_covariance
    assert covariance is not None
    spread = np.sqrt(np.trace(covariance, axis1=2, axis2=3))[row][:, mine]
    keep = (keep & near)[:, None] & np.isfinite(error)
    found = (error, free[row][:, limb], hidden[row][:, limb], spread)
    return Looked(*(x[keep] for x in found))
