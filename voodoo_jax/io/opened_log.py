"""A log between both passes over it.

The first pass collects stamps, calibrations, transforms and features, and assigns messages to frames; the second
decodes the depth messages one by one. So memory stays bounded, and a calibration may come after the images.
"""

from collections import Counter
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int64

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.config.toml import check_pairs
from voodoo_jax.io.as_shown import TELLING
from voodoo_jax.io.calibrations import calibration_of, fitted, leeway
from voodoo_jax.io.container import LogError
from voodoo_jax.io.decode.image_codec import raw_of
from voodoo_jax.io.decode.registry import DECODE_ERRORS, Decoder
from voodoo_jax.io.frame_pass import UNREADABLE, FramePass
from voodoo_jax.io.given import given_transforms
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.log_summary import damaged
from voodoo_jax.io.measuring import Measuring
from voodoo_jax.io.pictures import shape_of
from voodoo_jax.io.pose_rays import NAMES
from voodoo_jax.io.read_plan import Plan
from voodoo_jax.io.repeats import Repeats
from voodoo_jax.records.messages import Cloud, Image, many, stride
from voodoo_jax.records.notes import DAMAGED, as_few
from voodoo_jax.records.recording import NO_PAIRS, NO_RAYS, Frame, Pairs, Rays

BEGAN = "which repeat the first image, at the beginning: the sensor or its driver was frozen"
FEW_POINTS = 5000  # of a message that are looked at to see whether it shows something


@dataclass(frozen=True)
class Sample:
    """One message of a depth topic, decoded in advance."""

    number: int  # of the topic's messages
    content: Cloud | Image
    distances: Float[np.ndarray, " point"]  # from the sensor, in metres if its unit is the usual one


class LogReader:
    """A log opened for reading frame by frame. `notes` is complete once `frames()` has run through."""

    def __init__(self, scan: Scan, plan: Plan, settings: ReadSettings):
        self.scan, self._settings = scan, settings
        self.path, self.fixed_frame, self.up, self.sensors = scan.log.path, plan.fixed_frame, plan.up, plan.sensors
        self.origin, self.up_is_given = plan.origin, bool(settings.up)
        self.features, self.parts = plan.features, plan.parts.names
        self._plan = plan
        self._notes = [*scan.notes, *scan.tree.notes, *plan.notes]
        self.counted: Counter[tuple[str, str]] = Counter()  # events with messages, by topic and event
        self._decoder, self._repeats = Decoder(), Repeats()
        self.sure = 1.0  # probability that places are right for which a calibration was assumed
        self.placed: tuple[str, ...] = ()  # transforms that were found, as read.transform says them
        scales = check_pairs("read.scale", settings.scale)
        radial = check_pairs("read.radial", settings.radial)
        mirrors = check_pairs("read.mirror", settings.mirror)
        self.measuring = Measuring(
            scan.topics, scan.tree, plan.fixed_frame, settings, plan.parts,
            scales={name: float(value) for name, value in scales.items()},
            radial={name: word == "yes" for name, word in radial.items()},
            mirrored={name: "xyz".index(axis) for name, axis in mirrors.items() if axis in ("x", "y", "z")},
        )  # fmt: skip

    @property
    def scales(self) -> dict[str, float]:
        """Metres per unit of topics, if unusual."""
        return self.measuring.scales

    def unit(self, topic: str) -> float:
        """Usual metres per unit of a depth topic's encoding."""
        sample = self.scan.topics[topic].sample
        return sample.unit if isinstance(sample, Image) else 1.0

    def frame_name(self, topic: str) -> str:
        """The coordinate frame of a depth topic."""
        return self.scan.topics[topic].sample.frame

    def move(self, topic: str, T: Float[np.ndarray, "4 4"]) -> tuple[str, str]:
        """Moves a static sensor by `T`, in the fixed frame. Returns the read.transform texts of its new pose and of
        that of the log; both are empty if the log's transforms do not allow this."""
        name, tree = self.frame_name(topic), self.scan.tree
        before = tree.said(name)
        if not tree.move(name, self.fixed_frame, T):
            return "", ""
        self.placed += (tree.said(name),)
        return self.placed[-1], before

    def moved_by(self, topic: str) -> set[str]:
        """Topics of the transforms by which a sensor moves."""
        frames = self.scan.tree.moving_between(self.frame_name(topic), self.fixed_frame)
        return {self.scan.moves[frame] for frame in frames if frame in self.scan.moves}

    @property
    def given_frames(self) -> set[str]:
        """Frames with a pose from read.transform."""
        return {transform.child for transform in given_transforms(self._settings.transform)}

    def is_image(self, topic: str) -> bool:
        """Whether a topic's messages are images, not clouds."""
        return isinstance(self.scan.topics[topic].sample, Image)

    @property
    def unpacks(self) -> bool:
        """Whether images are unpacked or a network looks at them, which takes long and lets other threads run. All else
        is read as fast as it is handed from one thread to another."""
        samples = (self.scan.topics[topic].sample for topic in self.sensors)
        packed = any(isinstance(sample, Image) and sample.packed is not None for sample in samples)
        return packed or bool(self.scan.stereo or self._settings.pose_net)

    def with_scales(self, scales: dict[str, float]) -> "LogReader":
        """The same log with other units of some topics, metres per unit."""
        return self._with(scales={**self.scales, **scales})

    def _with(self, **changes: Any) -> "LogReader":
        """The same log with other fields of `measuring`."""
        other = copy(self)
        other.measuring = replace(self.measuring, **changes)
        other._notes, other.counted = list(self._notes), Counter()
        return other

    def without_sheets(self, topics: frozenset[str]) -> "LogReader":
        """The same log without the points in the smeared edges of some depth images, see geometry.depth_edges."""
        return self._with(smeared=topics)

    def with_crop(self, topic: str, moved: tuple[float, float], sure: float = 1.0) -> "LogReader":
        """The same log with the principal point of a topic's cropped images moved by pixels to the right and down,
        relative to a central crop; right with the probability `sure`."""
        other = self._with(moved={**self.measuring.moved, topic: moved}, rays={}, turned={}, assumed={})
        other.sure *= sure
        return other

    def mirrored(self, topic: str) -> "LogReader | None":
        """The same log with a topic's images (clouds: x) mirrored left to right; None where read.mirror names it."""
        if topic in check_pairs("read.mirror", self._settings.mirror):
            return None
        return self._with(mirrored={**self.measuring.mirrored, topic: 0})

    def leeway(self, topic: str) -> tuple[tuple[float, float], float]:
        """Uncertainty of a topic's crop offset, pixels across and down, and the focal length, pixels."""
        shape = shape_of(self.scan.topics[topic].sample)
        c = None if shape is None else calibration_of(self.scan.topics, topic)
        if shape is None or c is None:
            return (0.0, 0.0), 1.0
        try:
            return leeway(c, shape), float(fitted(c, shape)[0].K[0, 0])
        except ValueError:  # asked, or left out, where its images are used
            return (0.0, 0.0), 1.0

    @property
    def cameras(self) -> tuple[str, ...]:
        """Topics whose colour images are used by themselves, not as pairs."""
        return tuple(self._plan.pictures.cameras) if self._plan.pictures is not None else ()

    def depth(self, topic: str, image: Image, every: int = 1) -> Float32[np.ndarray, "row column"] | None:
        """See Measuring.depth."""
        return self.measuring.depth(topic, image, every)

    def continued(self, scan: Scan, plan: Plan) -> "LogReader":
        """The same log with later messages: a new scan and plan."""
        other = copy(self)
        other.scan, other._plan = scan, replace(plan, up=self.up)
        other.sensors, other.features = plan.sensors, plan.features
        other._notes, other.counted = [], Counter()
        # what was assumed is said already
        other.measuring = replace(self.measuring, topics=scan.topics, tree=scan.tree, parts=plan.parts, assumed={})
        return other

    def coarse(self, max_points: int) -> "LogReader":
        """The same log with at most this many points of each message."""
        other = self._with(settings=replace(self._settings, max_points=max_points))
        other._settings = other.measuring.settings
        return other

    def stamps(self, topic: str) -> Int64[np.ndarray, " message"]:
        """Stamps of a depth topic's messages in the order of reading, nanoseconds."""
        return self._plan.stamps[self.sensors.index(topic)]

    def say(self, note: str) -> None:
        """Adds a note."""
        self._notes.append(note)

    def sampled(
        self, topic: str, count: int, spread: bool = False, step: int = 1, at: Int64[np.ndarray, " time"] | None = None
    ) -> list[Sample]:
        """Some non-empty messages of a depth topic: the first ones (subsampled), or `spread` over the log, or those
        nearest to some times (nanoseconds)."""
        total = len(self.scan.topics[topic].stamps)
        step = max(1, total // count) if spread else step
        stamps = self.stamps(topic)
        near = None if at is None else {int(np.argmin(np.abs(stamps - t))) for t in at}
        last = total if spread else 60 + step * count  # two seconds of darkness
        last = last if near is None else max(near, default=0)
        found, decoder = [], Decoder()
        stereo = {pair.left for pair in self.scan.stereo}
        for _, number, (schema, channel, message) in self.scan.numbered((topic,)) if topic not in stereo else ():
            self.scan.log.clock.check()
            if number > last:
                break
            if (number % step if near is None else number not in near) or schema is None:
                continue
            try:
                content = decoder.message(schema, channel, message.data)
                distances = _distances(content)
            except DECODE_ERRORS:
                continue
            if len(distances) >= TELLING:
                found.append(Sample(number, content, distances))
            if len(found) == count:
                break
        return found

    def frame_of(self, topic: str, sample: Sample) -> Frame | None:
        """A frame of one message, in the fixed frame; None without a transform."""
        at = int(self.stamps(topic)[sample.number])
        measured = self.measuring.measured(topic, sample.content, at, self.counted)
        if measured is None:
            return None
        sensor = np.zeros(len(measured.points), np.int32)
        return Frame(at, measured.points.astype(np.float32), sensor, measured.origin[None].astype(np.float32))

    def __len__(self) -> int:
        """Number of frames planned; fewer come out if messages turn out to be broken or have no transform."""
        return len(self._plan.frames)

    @property
    def named(self) -> list[tuple[Rays, Pairs]]:
        """The features of each frame that has any."""
        rays, pairs = self._plan.rays, self._plan.pairs
        return [(rays.get(i, NO_RAYS), pairs.get(i, NO_PAIRS)) for i in rays.keys() | pairs.keys()]

    @property
    def named_at_once(self) -> set[tuple[str, ...]]:
        """Names of the features of each frame that has any."""
        net = NAMES if self._settings.pose_net else ()
        return {(*r.names, *net, *p.names) for r, p in self.named} | ({net} if net else set())

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out, missing or damaged, one sentence each."""
        return as_few([*self._notes, *self.measuring.assumed.values(), *self._losses(), *self._damage()])

    def _damage(self) -> list[str]:
        """A sentence if frames were lost to damage."""
        lost = self.scan.lost({*self.sensors, *self.features})
        lost += sum(n for (_, what), n in self.counted.items() if what == UNREADABLE)
        lost += sum(self.scan.topics[name].broken for name in self.features)
        if lost:
            return [f"{DAMAGED}{many(lost)} that frames were to be made of {'is' if lost == 1 else 'are'} lost."]
        # without statistics nobody knows how many there were
        unsure = self.scan.log.declared is None and any("cannot be read" in text for text in self.scan.log.damage)
        if unsure:
            return [f"{DAMAGED}how many frames are lost is not known."]
        return []

    def _losses(self) -> list[str]:
        counted = [f"'{topic}': {many(n)} {what}." for (topic, what), n in self.counted.items()]
        counted += [f"'{topic}': {many(n)} {BEGAN}." for topic, n in self._repeats.began.items()]
        return counted + self._plan.parts.losses()

    def frames(self, origins: Float[np.ndarray, "sensor 3"] | None = None) -> Iterator[Frame]:
        """Frames in the order of their stamps. `origins` are the last positions of sensors (NaN: unknown), updated in
        place.

        Raises LogError if not one message can be used.
        """
        self.scan.log.clock.restart()  # it goes by this thread, which may be another one than before
        self.counted = Counter()
        made = FramePass(
            self.scan, self._plan, self._settings, self.measuring, self._decoder, self._repeats, self.counted,
            self.no_origins() if origins is None else origins,
        )  # fmt: skip
        yield from made.frames()
        if not made.made:
            text = " ".join([f"'{self.path}': no depth message can be used.", *self._losses(), made.error]).strip()
            if any(what == UNREADABLE for _, what in self.counted):
                text = f"{text}. It is damaged, or was written by another version: copy it again."
            raise LogError(damaged(self.scan, LogError(text)))

    def no_origins(self) -> Float[np.ndarray, "sensor 3"]:
        """Positions of sensors before their first measurement: NaN."""
        return np.full((len(self.sensors), 3), np.nan) if self.sensors else np.zeros((1, 3))


def _distances(content: Cloud | Image) -> np.ndarray:
    """Of a few thousand points from the sensor, in the usual unit; without those that saw nothing."""
    if isinstance(content, Image):
        raw = raw_of(content)
        k = stride(*content.shape, FEW_POINTS)
        # nothing, and the largest number, which some drivers write for it
        z = np.zeros(0) if raw is None else raw[::k, ::k].ravel()
        z = z[(z > 0) & (z < 65535)] if z.dtype == np.uint16 else z
        found = z.astype(float) * content.unit
    else:
        found = np.linalg.norm(content.points(FEW_POINTS), axis=1)
    return found[np.isfinite(found) & (found > 0)]
