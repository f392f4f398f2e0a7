"""What is taken away or changed, one thing at a time, and a trial of it. Worker processes import this."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.common import human, settings_with, without_features
from experiments.judged import Verdict, judge, segmented, told_apart
from voodoo_jax.config.options import Settings
from voodoo_jax.detect import pipeline as detection
from voodoo_jax.model.body import Body
from voodoo_jax.model.body_file import load_body
from voodoo_jax.trackers.icp import pipeline as icp

# stage and option of the settings = value; "body" names another body
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "solver limb by limb": {"solve.solver": "per_limb"},
    "both sides of limbs (near_side off)": {"solve.near_side": False},
    "all pairs count fully (robust_scale inf)": {"solve.robust_scale": float("inf")},
    "prior x 10": {"solve.prior": 10 * Settings().solve.prior},
    "prior / 10": {"solve.prior": Settings().solve.prior / 10},
    "what stands still is not held (steady 0)": {"solve.steady": 0.0},
    "no velocity (damping 0)": {"track.damping": 0.0},
    "forwards only (track.skip looks_ahead)": {"track.skip": ("looks_ahead",)},
    "prior the same over any interval": {"track.prior_interval": 10.0},
    "hidden limbs left alone (hidden_rest 0)": {"track.hidden_rest": 0.0},
    "no features": {"read.features": False},
    "joints beyond their limits left (limits 0)": {"solve.limits": 0.0},
    "collisions 0.3": {"solve.collisions": 0.3},
    "ten limbs (human10)": {"body": "human10"},
    "one heading at the start": {"start.headings": 1},
    "no later start": {"start.later": ()},
    "256 points": {"detect.points": 256},
    "at most 6 steps": {"solve.max_steps": 6},
    "epsilon 1e-5": {"solve.epsilon": 1e-5},
    "exact closest points (refine 4)": {"solve.refine": 4},
    # each stage of detection and of tracking, in the order in which they run
    **{f"without {stage.name}": {"detect.skip": (stage.name,)} for stage in detection.stages()},
    **{f"without {stage.name}": {"track.skip": (stage.name,)} for stage in icp.stages()},
}


@dataclass(frozen=True)
class Job:
    """One variant on one recording."""

    variant: str
    log: Path
    step: int = 1  # every so many-th frame is kept
    frames: int = 0


def variant(name: str) -> tuple[Body, Settings]:
    """Body and settings of a variant."""
    options = dict(VARIANTS[name])
    body = options.pop("body", None)
    return human() if body is None else load_body(body), settings_with(options)


def work(job: Job) -> Verdict:
    """Tracks and judges."""
    body, settings = variant(job.variant)
    if settings.detect.skip:  # not kept for other variants
        recorded, log = segmented(job.log, settings, job.step, job.frames)
    else:
        recorded, log = told_apart(job.log, job.step, job.frames)
    people = log.people if settings.read.features else without_features(log.people)
    return judge(recorded, log, log.track(body, settings, people))
