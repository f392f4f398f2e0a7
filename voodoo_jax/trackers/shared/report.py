"""Tracks of a whole recording from its segment: joints, covariances, and measures of implausibility. Host side."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Float32, Float64

from voodoo_jax.compile.executable import program
from voodoo_jax.detect.camera_motion import to_fixed
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.kernels.joint_limits import check
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Evidence, Status, Tracks
from voodoo_jax.solve.covariance import covariances
from voodoo_jax.trackers.base import LogInfo
from voodoo_jax.trackers.shared.runner import FrameRunner, spans


class Derived(NamedTuple):
    """Values derived from the poses of some frames. Leading axis: frame."""

    joints: Float[Any, "frame joint 3"]  # joint centres `body.topology.centres`, metres
    beyond_limits: Float[Any, "frame bodyjoint"]  # of `body.topology.joints`, radians
    depth_inside: Float[Any, "frame limb"]  # in another limb, more than in the rest pose, metres
    limb_covariance: Float[Any, "frame limb 6 6"]  # turn (rad), shift (m) in the limb's frame
    joint_covariance: Float[Any, "frame joint 3 3"]  # square metres


@program
def looked_at(body: Body, poses: Poses, twist: Float[Array, "frame limb 6 6"]) -> Derived:
    """Joint centres of a chunk of frames, their covariances, and measures of implausibility."""
    centres, odd = jax.vmap(lambda some: (joint_centres(body, some), check(body, some)))(poses)
    return Derived(centres, odd.beyond, odd.depth, *covariances(body, poses, twist))


def tracks_of(run: FrameRunner, segment: Segment, source: LogInfo) -> Tracks:
    """Tracks of a whole recording, with all values derived from its poses. Moves the poses to the fixed frame in place;
    covariances replace those of the segment.

    **Arguments:** `segment` all frames of the recording; `source` metadata of the log.
    """
    to_fixed(run.people, segment.rotation, segment.translation)
    segment.residual[segment.status == Status.NO_DATA] = np.nan
    chunk = run.settings.track.chunk
    derived = _room(run.body, segment)
    for first, end, body in spans(run.bodies, len(segment)):
        absent = ~np.asarray(body.present)
        for array in (segment.rotation, segment.translation, segment.limb_covariance):
            array[first:end, absent] = np.nan
        for at in range(first, end, chunk):
            span = slice(at, min(at + chunk, end))
            for array, part in zip(derived, derived_from(body, segment[span], chunk)):
                array[span] = part
    return Tracks(
        source.path, source.fixed_frame, run.body,
        time_ns=np.array([f.time_ns for f in run.people], np.int64),
        rotation=segment.rotation, translation=segment.translation, joints=derived.joints, status=segment.status,
        evidence=Evidence(
            segment.residual, segment.explained, segment.steps, np.array([len(f.points) for f in run.people], np.int32),
            segment.limb_weight, segment.passes_apart, derived.beyond_limits, derived.depth_inside,
            facing_odds=segment.facing_odds, matched=any(f.matched for f in run.people),
        ),
        limb_covariance=derived.limb_covariance, joint_covariance=derived.joint_covariance, up=_up(run),
        T_fixed_steady=_sensor_motion(run.people),
    )  # fmt: skip


def _sensor_motion(people: list[BodyObservation]) -> Float64[np.ndarray, "frame 4 4"] | None:
    """Motion of sensors that are static in the log, see Tracks; None without motion."""
    motion = [np.eye(4) if frame.T_fixed_steady is None else frame.T_fixed_steady for frame in people]
    return np.stack(motion) if any(frame.T_fixed_steady is not None for frame in people) else None


def _up(run: FrameRunner) -> Float32[np.ndarray, "3"]:
    """Upward direction in the fixed frame; for a camera with motion that the log lacks, in its first frame."""
    normal = np.asarray(run.scene.floor.normal, np.float32)
    T = run.people[0].T_fixed_steady if run.people else None
    return normal if T is None else (T[:3, :3] @ normal).astype(np.float32)


def _room(body: Body, segment: Segment) -> Derived:
    """Empty arrays for the values derived from a segment's poses; those of the segment for covariances of limbs."""
    t = body.topology
    rows = (len(t.centres), 3), (len(t.joints),), (len(t.limbs),), (len(t.limbs), 6, 6), (len(t.centres), 3, 3)
    found = Derived(*(np.empty((len(segment), *row), np.float32) for row in rows))
    return found._replace(limb_covariance=segment.limb_covariance)


def derived_from(body: Body, segment: Segment, chunk: int) -> Derived:
    """Values derived from the poses of up to `chunk` frames with one body; on the host, NaN where there is no pose."""
    found = looked_at(body, *padded(segment, chunk))
    there = np.any(np.isfinite(segment.translation), (1, 2))
    each = (np.asarray(array, np.float32)[: len(segment)] for array in found)
    return Derived(*(np.where(there.reshape(-1, *[1] * (array.ndim - 1)), array, np.float32(np.nan)) for array in each))


def padded(segment: Segment, chunk: int) -> tuple[Poses, jax.Array]:
    """Poses of some frames and their limbs' covariances, as looked_at takes them: one program for every length."""
    pad = ((0, chunk - len(segment)), (0, 0), (0, 0))
    poses = Poses(np.pad(segment.rotation, pad), np.pad(segment.translation, pad))
    return poses, jax.device_put(np.pad(segment.limb_covariance, (*pad, (0, 0))))
