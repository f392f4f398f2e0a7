"""A log opened for tracking: what it says of units and clocks is compared with what it shows; depth cameras that smear
edges are detected by their first images; wrong relative poses of sensors are corrected. Host side, NumPy.

A surface that two sensors see must coincide: point-to-plane ICP (Chen and Medioni 1992,
doi:10.1016/0262-8856(92)90066-C) of one sensor's points onto the static surfaces that the others see, with one rigid
transform for several frames.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64, Int64
from scipy.spatial import KDTree

from voodoo_jax.config.options import DetectSettings, ReadSettings
from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.camera_motion import FASTER, STILL, moved, onto_planes, turned
from voodoo_jax.detect.crops import with_crops
from voodoo_jax.detect.delays import POINTS, WINDOW, late_transforms, offsets
from voodoo_jax.detect.segmentation import CELL
from voodoo_jax.detect.units import FIRST, with_units
from voodoo_jax.detect.visibility import Nearest
from voodoo_jax.geometry.depth_edges import SMEARED, between_edges
from voodoo_jax.geometry.voxels import Counted, cells_of
from voodoo_jax.io.container import LogFile, Place
from voodoo_jax.io.convert.sources import as_mcap
from voodoo_jax.io.log_reader import NOT_OFF, TORN, LogReader, is_decisive, off_level, open_log, read_whole
from voodoo_jax.records.messages import Image
from voodoo_jax.records.recording import Frame, Recording
from voodoo_jax.records.tracks import RIGHT

# By hand, tried on simulated pairs of cameras; judged on others in experiments/scoreboard/promises/sensors_agree.py
# Frames of a sensor, spread over the beginning; points around one that show its normal.
FRAMES, PATCH = 10, 12
# By hand, as above: metres from a surface, at most; share of a sensor's upright points on others' surfaces, and points,
# at least; times as many as in another pose that is not as good
REACH, SHARED, FEWEST, BETTER = 0.35, 0.1, 100, 1.2
# By hand, as above: degrees and metres from the first fit, at which further ones begin, and how many; steps of each
YAWS, SHIFTS, TRIED, STEPS = (-6.0, -3.0, 0.0, 3.0, 6.0), (-0.15, 0.0, 0.15), 4, 30
# cosine between normals of one surface, or of an upright one and up; of a patch's extent, squared, at most; by hand
FACING, FLAT = 0.8, 0.05
NOISE = 0.015  # metres, of depth at 3 metres (Khoshelham and Elberink 2012, doi:10.3390/s120201437: 0.013)
ON, OFF = 4 * NOISE, 2 * NOISE  # distances from which two surfaces are different, and up to which they agree; by hand
STAYS = 0.7  # share of the frames with points at the place of a static surface; by hand
PERSON = Build(1.70, 0.44)  # where nobody says who is looked for: the size of the body file `human`, measured


class Surface(NamedTuple):
    """Surface points of a sensor in one frame."""

    points: Float64[np.ndarray, "point 3"]
    normals: Float64[np.ndarray, "point 3"]  # unit, towards the sensor
    eyes: Float64[np.ndarray, "point 3"]  # the sensor's place

    def under(self, T: Float[np.ndarray, "4 4"]) -> "Surface":
        """The surface and its sensor, moved by a transform."""
        return Surface(moved(self.points, T), self.normals @ T[:3, :3].T, moved(self.eyes, T))

    def seen_through(self, other: "Surface") -> float:
        """The share of the points that are where the other's sensors see nothing."""
        points, there, eyes = (p.astype(np.float32) for p in (self.points, other.points, other.eyes))
        origins, sensor = np.unique(eyes, axis=0, return_inverse=True)
        nearest = Nearest.of(there, sensor.ravel(), origins)
        return max(float(nearest.empty(points, np.full(len(points), k)).mean()) for k in range(len(origins)))


def with_sensors_in_place(reader: LogReader) -> LogReader:
    """The reader with each misplaced sensor moved so that its surfaces fit those of the others. If more than one pose
    fits, the sensor is not moved, and `reader.sure` decreases. Moving sensors are left out. Of two that contradict each
    other, the one whose floor is less level is moved, but none with a pose from read.transform."""
    one_each = {reader.frame_name(topic): topic for topic in reversed(reader.sensors)}
    if len(one_each) < 2:
        return reader
    given, coarse = reader.given_frames, reader.coarse(POINTS)
    off = {topic: NOT_OFF if frame in given else off_level(reader, topic) for frame, topic in one_each.items()}
    first, *others = sorted(off, key=lambda topic: (reader.frame_name(topic) not in given, off[topic], topic))
    begun = max(int(reader.stamps(topic).min()) for topic in off)
    ended = min(int(reader.stamps(topic).max()) for topic in off)
    times = np.linspace(begun, min(ended, begun + int(WINDOW * 1e9)), FRAMES).astype(np.int64)
    known = _surfaces(coarse, first, times)
    for topic in others if known else ():
        mine, there = _surfaces(coarse, topic, times), _joined(known)
        T, doubt = correction(there, mine, reader.up)
        if (other := _mirrored(reader, (first, topic), times, there, mine, T)) is not reader:
            reader, coarse = other, other.coarse(POINTS)
            mine = _surfaces(coarse, topic, times)
            T, doubt = correction(there, mine, reader.up)
        away = max((_apart(one.points, T, STILL) for one in mine if len(one.points)), default=0.0)
        lines, sure = ("", ""), doubt < OFF
        away += 0.0 if sure else doubt
        if away > (OFF if sure else RIGHT) and reader.frame_name(topic) not in given:
            lines = reader.move(topic, T) if sure else lines
            _say(reader, (first, topic), away, is_decisive(off[first], off[topic]), lines)
        T = T if lines[0] else STILL  # as it is read from now on
        known += [one.under(T) for one in mine]
    return reader


# 6 parameters: two sensors, and what is known of them
def _mirrored(
    reader: LogReader, topics: tuple[str, str], times: Int64[np.ndarray, " time"], there: Surface,
    mine: Sequence[Surface], T: Float[np.ndarray, "4 4"],
) -> LogReader:  # fmt: skip
    """The reader with the second sensor's images mirrored, and a note, if they show what is `there` then and do not in
    any pose as they are; the same reader otherwise. In doubt if mirroring the first sensor's does, too."""
    (first, topic), up = topics, reader.up
    least = max(SHARED, BETTER * max(_shared(there, mine, pose, up) for pose in (STILL, T)))
    found = reader.mirrored(topic) if least < 1 else None
    if found is None or _shared(there, _surfaces(found.coarse(POINTS), topic, times), STILL, up) <= least:
        return reader
    other = reader.coarse(POINTS).mirrored(first)
    torn = other is not None and _shared(_joined(_surfaces(other, first, times)), mine, STILL, up) > least
    found.sure *= TORN if torn else 1.0
    found.say(
        f"'{topic}' sees what '{first}' sees, too, if its images are mirrored left to right: taken so"
        f"{f' (or those of {first!r} are: nothing tells which)' * torn}. read.mirror settles it: {topic}=x (or =none)."
    )
    return found


def _shared(there: Surface, mine: Sequence[Surface], T: Float[np.ndarray, "4 4"], up: np.ndarray) -> float:
    """See _Views.shared; 0 without points."""
    mine = tuple(one for one in mine if len(one.points))
    return _Views(there, KDTree(there.points), mine).shared(T, up) if mine and len(there.points) else 0.0


def _joined(surfaces: Sequence[Surface]) -> Surface:
    return Surface(*map(np.concatenate, zip(*surfaces)))


def _say(reader: LogReader, topics: tuple[str, str], away: float, settled: bool, lines: tuple[str, str]) -> None:
    """Adds a note on the contradiction of two sensors and its correction, and sets the reliability of positions."""
    (first, topic), (line, before) = topics, lines
    if away > RIGHT and not (line and settled):
        reader.sure *= TORN
    found = f"'{topic}' sees what '{first}' sees, too, up to {100 * away:.0f} cm off: one of their transforms is wrong"
    if not line:
        reader.say(f"{found}. The error is uncertain; set read.transform.")
        return
    why = "the floor is level with that of the others" if settled else "nothing tells which"
    reader.say(
        f'{found} ({why}). It was moved, as --read.transform "{line}" says; --read.transform "{before}" says that the '
        "other one is wrong."
    )


class _Views(NamedTuple):
    """Surfaces of the other sensors, and of one sensor, in several frames."""

    there: Surface
    tree: KDTree
    mine: tuple[Surface, ...]

    def matched(self, T: np.ndarray, reach: float, every: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A subset of the points that have a surface of the others within reach, with the same facing; the normals of
        that surface, and the signed distances from it, metres."""
        points = moved(np.concatenate([one.points[::every] for one in self.mine]), T)
        facing = np.concatenate([one.normals[::every] for one in self.mine]) @ T[:3, :3].T
        away, which = self.tree.query(points, distance_upper_bound=reach)
        near = np.flatnonzero(np.isfinite(away))
        near = near[np.sum(facing[near] * self.there.normals[np.asarray(which)[near]], 1) > FACING]
        points, nearest = points[near], np.asarray(which)[near]
        normals = self.there.normals[nearest]
        return points, normals, np.sum((points - self.there.points[nearest]) * normals, 1)

    def shared(self, T: np.ndarray, up: np.ndarray | None = None, near: float = OFF) -> float:
        """The share of the points that lie `near` surfaces of the others, metres; with `up`, only points on upright
        surfaces, since level ones fit after any level shift."""
        _, normal, off = self.matched(T, 2 * near, 4)
        asked = np.concatenate([one.normals[::4] for one in self.mine])
        on = np.clip(1 - (off / near) ** 2, 0, None) ** 2
        if up is not None:
            on, asked = on[np.abs(normal @ up) < FACING], asked[np.abs(asked @ up) < FACING]
        return float(on.sum() / max(len(asked), 1))

    def agreed(self, T: np.ndarray, up: np.ndarray) -> float:
        """The share of the points on upright surfaces that are shared, less that of the points seen through."""
        mine = _joined(self.mine).under(T)
        return self.shared(T, up) - mine.seen_through(self.there) - self.there.seen_through(mine)

    def fitted(self, T: np.ndarray = STILL, reach: float = REACH) -> np.ndarray:
        """The best fit of the sensor's surfaces to the others', from `T` on."""
        pivot = self.middle
        for _ in range(STEPS):
            points, normal, off = self.matched(T, reach)
            if len(off) < FEWEST:
                return T
            size = np.full(len(off), reach)
            x, _, _ = onto_planes(points - pivot, normal, off, np.full(len(off), NOISE), size, np.zeros(6))
            T = turned(x, pivot) @ T
            if reach <= ON and np.abs(x).max() < 1e-3:
                break
            reach = max(reach * FASTER**0.5, ON)
        return T

    @property
    def middle(self) -> np.ndarray:
        return np.concatenate([mine.points for mine in self.mine]).mean(0)


def correction(
    there: Surface, mine: Sequence[Surface], up: Float[np.ndarray, "3"]
) -> tuple[Float64[np.ndarray, "4 4"], float]:
    """The transform that takes a sensor's surfaces, frame by frame, onto those of the others, and how far another as
    good takes them elsewhere, metres. The identity if they coincide already, or if it cannot be determined."""
    mine = [one for one in mine if len(one.points)]
    if len(mine) < 2 or len(there.points) < FEWEST:
        return STILL, 0.0
    both = _Views(there, KDTree(there.points), tuple(mine))
    T, points = both.fitted(), np.concatenate([mine.points for mine in both.mine])[::10]
    if _apart(points, T, STILL) < OFF and both.shared(STILL, up) > SHARED:  # not only level ones, which always fit
        return STILL, 0.0
    level = np.linalg.svd(up[None].astype(float))[2][1:]
    starts = [
        turned(np.concatenate([np.radians(yaw) * up, a * level[0] + b * level[1]]), both.middle) @ T
        for yaw in YAWS for a in SHIFTS for b in SHIFTS
    ]  # fmt: skip
    best = sorted(starts, key=lambda start: -both.shared(start, up, SHIFTS[-1] / 2))[:TRIED]  # as near as they are
    fits = [T, *(both.fitted(start) for start in best)]
    shares = [both.agreed(fit, up) for fit in fits]
    if max(shares) <= max(SHARED, BETTER * both.agreed(STILL, up)):
        # level surfaces alone are brought together, if those
        return (T, OFF) if both.shared(T) > BETTER * both.shared(STILL) else (STILL, 0.0)
    found = fits[int(np.argmax(shares))]
    as_good = [fit for fit, share in zip(fits, shares) if BETTER * share > max(shares)]
    halves = [both._replace(mine=both.mine[k::2]).fitted(found, 2 * ON) for k in (0, 1)]
    return found, max(_apart(points, found, other) for other in (*as_good, *halves))


def _apart(points: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """Root mean square distance between points under two transforms, metres."""
    return float(np.sqrt(np.mean(np.sum((moved(points, one) - moved(points, other)) ** 2, 1))))


def _surfaces(reader: LogReader, topic: str, at: Int64[np.ndarray, " time"]) -> list[Surface]:
    """Static surfaces of a sensor around some times; none for a moving one."""
    samples = reader.sampled(topic, FRAMES, at=at)
    frames = [frame for sample in samples if (frame := reader.frame_of(topic, sample)) is not None]
    if not frames or np.ptp([frame.origins[0] for frame in frames], axis=0).max() > 0.01:
        return []
    seen = Counted(CELL)
    for frame in frames:
        seen.add(cells_of(frame.points, CELL), 1.0)
    return [_surface(frame, seen.at(frame.points) >= STAYS * len(frames)) for frame in frames]


def _surface(frame: Frame, still: Bool[np.ndarray, " point"]) -> Surface:
    """The static points of a frame on smooth surfaces, with normals."""
    points = frame.points.astype(float)
    if len(points) < PATCH:
        return Surface(points[:0], points[:0], points[:0])
    around = points[KDTree(points).query(points[still], PATCH)[1]] - points[still][:, None]
    normals, flat = normals_of(around - around.mean(1, keepdims=True))
    normals *= np.sign(np.sum(normals * (frame.origins[0] - points[still]), 1))[:, None]
    points = points[still][flat]
    return Surface(points, normals[flat], np.broadcast_to(frame.origins[0].astype(float), points.shape))


def normals_of(patches: Float[np.ndarray, "patch point 3"]) -> tuple[np.ndarray, np.ndarray]:
    """The normal of each patch of points about their middle, and whether it is flat. No LAPACK in batches: where one
    eigenvalue is small, the adjugate of the covariance is the normal's projection, and its largest column the normal.
    """
    C = np.einsum("kpi,kpj->kij", patches, patches)
    rows = C[:, [1, 2, 0]], C[:, [2, 0, 1]]
    adjugate = np.cross(*rows)
    size = np.linalg.norm(adjugate, axis=2)
    best = np.take_along_axis(adjugate, size.argmax(1)[:, None, None], 1)[:, 0]
    normals = best / np.maximum(size.max(1), 1e-30)[:, None]
    least = np.einsum("ki,kij,kj->k", normals, C, normals)
    return normals, least < FLAT * np.trace(C, axis1=1, axis2=2)


def without_smeared_edges(reader: LogReader) -> LogReader:
    """The reader, without points at smeared depth edges, and with a note."""
    found = frozenset(topic for topic in reader.sensors if _smeared(reader, topic))
    for topic in sorted(found):
        reader.say(
            f"Depth edges in '{topic}' are smeared, as by a filter of its camera: points between near and far "
            "objects are left out."
        )
    return reader.without_sheets(found) if found else reader


def _smeared(reader: LogReader, topic: str) -> bool:
    if not reader.is_image(topic):
        return False
    images = [content for s in reader.sampled(topic, FIRST) if isinstance(content := s.content, Image)]
    shares = [between_edges(z) for image in images if (z := reader.depth(topic, image)) is not None]
    return bool(shares) and float(np.median(shares)) > SMEARED


def open_checked(
    path: Place | LogFile,
    settings: ReadSettings | None = None,
    build: Build = PERSON,
    detect: DetectSettings | None = None,
) -> LogReader:
    """A log as `io.log_reader.open_log` gives it, its units, crops and the places of its sensors checked by what its
    messages show, without what lies in smeared edges.

    **Arguments:** `build` how large the body is that is looked for. Raises as `open_log`, and LogError where units are
    in doubt.
    """
    settings, detect = settings or ReadSettings(), detect or DetectSettings()
    reader, late = _checked(path, settings, build, detect), {}
    looks = {
        "the room, which is at rest": lambda: late_transforms(reader),
        "what it and another sensor see move": lambda: offsets(reader, build, detect),
    }
    for how, look in looks.items() if not settings.delays else ():
        if not (found := look()):
            continue
        late |= {topic: (by, how) for topic, by in found.items()}
        delays = tuple(f"{topic}={by:g}" for topic, (by, _) in late.items())
        reader = _checked(path, replace(settings, delays=delays), build, detect)
        for topic, (by, how) in late.items():
            reader.say(
                f"'{topic}': its stamps are {abs(by):.2f} s {'late' if by > 0 else 'early'}, to judge by {how}: taken "
                "out. read.delays settles it."
            )
    return with_sensors_in_place(reader)  # not before: who moves is elsewhere at another time


def _checked(path: Place | LogFile, settings: ReadSettings, build: Build, detect: DetectSettings) -> LogReader:
    return without_smeared_edges(with_crops(with_units(open_log(path, settings), build, detect)))


def read_log(path: Place, settings: ReadSettings | None = None) -> Recording:
    """Reads a whole log into memory: see `open_checked`, `LogReader.frames` and `Recording`. Recordings of other
    formats are converted first.

    Raises LogError if the log cannot be read, has no usable measurements, or its units are ambiguous; ValueError if
    `settings.max_points` is less than 1.
    """
    with as_mcap(path, (settings or ReadSettings()).types) as (log, notes):
        read = read_whole(open_checked(log, settings))
    return read if log is path else replace(read, path=str(path), notes=(*notes, *read.notes))
