"""Notes for the user on a tracked recording: data left out, unknown or implausible; reliability of a log as a whole,
whose errors affect all joints equally; and whether its fixed frame is level, by its visible floor. Host side, NumPy.

The body is found by the floor, so that it is right in the log's own frame, however that is rotated. But if transforms
give the mounting of the sensor, a sloping visible floor means that either they are wrong, or the floor is a slope. If
they are wrong, so are all positions: 12 degrees are 60 cm at 3 m. Bayes' rule gives the odds.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from voodoo_jax.config.options import Settings
from voodoo_jax.detect.scene import STEEPEST
from voodoo_jax.markers.diagnostics import FEW, SHOWN, name_notes
from voodoo_jax.markers.own_sites import Named
from voodoo_jax.model.body import Body
from voodoo_jax.records.notes import remark
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.trackers.icp.right_scale import ENOUGH, LEVEL, Scale, scale_of
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.notes import implausible

# degrees, standard deviation of both angles of a level floor; measured: up to 0.6 in recordings and cases, 1.1 on a car
LEVEL_WITHIN = 1.0
# share of logs on a slope, and standard deviation of its angles, degrees; the same of mounts that transforms turn
# wrongly. Measured (experiments/numbers): each times or over 1.5 moves the 3.45 degrees from which on a fixed frame is
# doubted by 0.35 at most
SLOPES, SLOPE, WRONG, SPREAD = 0.03, 4.0, 0.05, 8.0
NOISY = 0.05  # metres: more than a depth camera's noise at 5 m
# degrees and metres by which sensors seem to move at most where that is no more than noise and drift of distances make
# of walls; measured: two at rest seem to move by 0.5 degrees and 9 cm, two in hands or shaken by 1.6 and 6, 5 and 16 cm
TURNED, SHIFTED = 1.0, 0.12


class Level(NamedTuple):
    """Estimates about the level of a fixed frame."""

    right: float = 1.0  # probability that transforms turn the sensor rightly, 0..1; 1 where there is hardly a doubt
    degrees: float = 0.0  # from the floor's normal to its z-axis


NO_DOUBT = Level()


def level_of(scene: Scene, people: list[BodyObservation], settings: Settings) -> Level:
    """Estimates about the fixed frame, whose z-axis points up: none if the user stated it, if no transform places the
    sensor, or if sensors were found to move."""
    origins = [frame.origins for frame in people[:1]]
    # a sensor in the frame's origin is the frame, which need not stand level
    mounted = bool(origins) and bool(np.any(origins[0]))
    moved = any(frame.T_fixed_steady is not None for frame in people)
    if not scene.floor_seen or not mounted or moved or settings.read.up:
        return NO_DOUBT
    return level_odds(float(np.degrees(np.arccos(np.clip(scene.floor.normal[2], -1.0, 1.0)))))


def level_odds(degrees: float) -> Level:
    """Estimates about a fixed frame in which the floor slopes by an angle in degrees; a model of two normal
    distributions. Where it is steeper than a floor may be, up is another axis."""
    density = lambda spread: np.exp(-0.5 * (degrees / spread) ** 2) / spread**2  # noqa: E731
    right = (1 - WRONG) * ((1 - SLOPES) * density(LEVEL_WITHIN) + SLOPES * density(SLOPE))
    sure = float(right / (right + WRONG * density(SPREAD)))
    return NO_DOUBT if sure >= ENOUGH or np.cos(np.radians(degrees)) < STEEPEST else Level(sure, degrees)


class LogDoubts(NamedTuple):
    """Estimates about a log's distances and its fixed frame."""

    scale: Scale
    level: Level

    @property
    def right(self) -> float:
        """Probability that both are right, 0..1."""
        return self.scale.right * self.level.right


def log_doubts(body: Body, scene: Scene, people: list[BodyObservation], settings: Settings) -> LogDoubts:
    """Estimates about a log from its main body and its floor; `body` with the estimated size. Settings by the user
    override them."""
    return LogDoubts(scale_of(body, scene, people, settings), level_of(scene, people, settings))


def _moved(T: Float[np.ndarray, "frame 4 4"]) -> str:
    """A note on sensors that seem to move; small motion may be caused by errors of distances, or by the scene."""
    turn = float(np.degrees(Rotation.from_matrix(T[:, :3, :3]).magnitude().max()))
    shift = float(np.linalg.norm(T[:, :3, 3], axis=1).max())
    out = f"this was compensated in {len(T)} frames (stage steady_sensors)."
    if turn < TURNED and shift < SHIFTED:
        return remark(f"Floor and walls seem to move by up to {100 * shift:.0f} cm, which may be noise: {out}")
    return f"The sensors move, by up to {turn:.0f} degrees, without a transform for it: {out}"


def _of_scale(run: Runner, scale: Scale) -> str:
    """A note on distances that seem to have a wrong scale."""
    rare = f"A stature of {float(run.body.scale):.2f} m is rare"
    floor = 100 * float(run.scene.floor.offset)
    where = f", and the floor {abs(floor):.0f} cm {'above' if floor > 0 else 'below'} the fixed frame's zero"
    return (
        f"{rare}{where if run.scene.floor_seen and abs(floor) > 100 * LEVEL else ''}: the log's distances may be "
        f"{scale.factor:.2f} times the true ones. Set read.scale (the unit), or start.scale (the true stature)."
    )


def _of_level(run: Runner, level: Level) -> str:
    """A note on a fixed frame that seems not to be level."""
    up = ",".join(f"{x:.2f}" for x in run.scene.floor.normal + 0.0)
    return (
        f"The floor slopes by {level.degrees:.0f} degrees in the fixed frame: either a transform has a wrong "
        f"rotation, and all positions are wrong, or it is a slope. Correct it by read.transform, or set read.up={up}."
    )


def notes_on(run: Runner, tracks: Tracks, named: Named) -> tuple[str, ...]:
    """Notes on a tracked recording; `named` whose named points these are."""
    notes = implausible(tracks) + name_notes(named)
    if not tracks.evidence.points.any() and any(len(frame.pairs.names) for frame in run.people):
        return (*notes, FEW)
    notes += run.scene.notes
    if not run.scene.floor_seen:
        notes.append(
            remark("No floor is in view: the fixed frame, the lowest points or the body's usual size give its height.")
        )
    doubts = log_doubts(run.body, run.scene, run.people, run.settings)
    if doubts.scale.right < 1 and tracks.tracked.any():
        notes.append(_of_scale(run, doubts.scale))
    if doubts.level.right < 1:
        notes.append(_of_level(run, doubts.level))
    moved = [T for frame in run.people if (T := frame.T_fixed_steady) is not None]
    if moved:
        notes.append(_moved(np.stack(moved)))
    noise = [frame.noise for frame in run.people if frame.noise > 0]
    if noise and np.median(noise) > NOISY:
        notes.append(
            f"Distances are noisy: {100 * np.median(noise):.0f} cm (median, where the body is). Joints are less exact."
        )
    if len(tracks.status) and np.all(tracks.status == Status.NOT_STARTED):
        notes.append("No object of the body's height was found: no frame is tracked.")
    if np.any(tracks.status == Status.LOST) and not tracks.tracked.any() and tracks.joint_confidence is not None:
        notes.append("The tracker was never certain of a person: no frame is tracked.")
    total = int(tracks.evidence.points.sum())
    if run.left_out:
        share, most = 100 * run.left_out / (run.left_out + total), run.settings.detect.points
        notes.append(remark(f"{share:.0f} % of the body's points were left out (detect.points = {most} per frame)."))
    unused = [(f"'{n}'", f"({c} times): no point on this body in features.names") for n, c in run.unknown.items()]
    if len(unused) > SHOWN:
        listed = ", ".join(name for name, _ in unused[:SHOWN]) + (", ..." if len(unused) > SHOWN else "")
        notes.append(f"{len(unused)} features were not used, without points on this body in features.names: {listed}")
    else:
        notes += [f"Feature {name} was not used {text}." for name, text in unused]
    if run.parts is not None and run.parts.unknown:
        names = ", ".join(sorted(run.parts.unknown))
        notes.append(f"The body has no limb {names}: points assigned to it count as on any limb of the body.")
    for _, change in run.pending:
        notes.append(f"The change at {change.time:g} s is after the last frame, and was not applied.")
    if run.settings.changes and run.settings.looks_ahead("track"):
        notes.append("The body changes during the log, so it was tracked forwards only.")
    if run.features_left_out:
        notes.append(f"{run.features_left_out} features were left out: their frames have too many.")
    return tuple(notes)
