"""A passage, the frames from one start of the tracker to the next: tracked there and back in time, and made one."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.joint_bend import wrong_bend
from voodoo_jax.records.segment import SEEN, Rows
from voodoo_jax.solve.scan import Step, cost_of
from voodoo_jax.trackers.icp.runner import Session, status_of


class Pass(NamedTuple):
    """Poses of consecutive frames, and how badly they explain what was measured."""

    rotation: Float32[np.ndarray, "frame limb 4"]  # unit quaternions wxyz
    translation: Float32[np.ndarray, "frame limb 3"]  # metres
    cost: Float[np.ndarray, " frame"]  # square metres, see kernels


FREE_BEND = 0.17  # radians beyond a joint's limits that say nothing: people differ
WRONG_WAY = 0.1  # radians beyond, mean of all joints and frames, that count as much as costs e times higher


def rows_of(run: Session, step: Step, first: int, count: int) -> Rows:
    """What tracks keep of the steps of `count` frames from `first` on."""
    span = slice(first, first + count)
    status = status_of(step, run.settings.track.lost_explained, run.named[span], run.featured[span])
    rows = {"rotation": step.poses.rotation, "translation": step.poses.translation, "cost": cost_of(step)}
    rows |= {name: getattr(step, field) for name, field in SEEN.items()}
    rows["passes_apart"] = np.full_like(rows["limb_weight"], np.nan)  # of one pass nobody knows
    return {"status": status} | {name: np.asarray(row)[:count] for name, row in rows.items()}


def tracked_anew(run: Session, first: int, poses: Poses, low: int, at: int, high: int) -> Rows:
    """Rows of frames `low` to `high` - 1 of a passage that begins in frame `first`, tracked both ways from `poses` in
    frame `at`."""
    back = rows_of(run, run.backwards(poses, first + low, first + at + 1), first + low, at + 1 - low)
    forth = rows_of(run, run.forwards(poses, first + at, first + high)[1], first + at, high - at)
    return {name: np.concatenate([row[:-1], forth[name]]) for name, row in back.items()}


def pass_of(run: Session, rows: Rows) -> Pass:
    """Poses of some frames, and what they cost; joints bent the wrong way cost more."""
    return Pass(rows["rotation"], rows["translation"], rows["cost"] * np.exp(bent(run, rows) / WRONG_WAY))


def bent(run: Session, rows: Rows) -> Float[np.ndarray, " frame"]:
    """How far joints are bent the wrong way, mean over the joints, radians."""
    return np.mean(np.maximum(wrong_bend(run.body, rows["rotation"]) - FREE_BEND, 0.0), 1)
