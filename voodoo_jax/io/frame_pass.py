"""The second pass over a log: decodes the planned messages one by one, and makes frames of them."""

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial

import numpy as np
from jaxtyping import Float

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.container import UNPACKERS, Item
from voodoo_jax.io.decode.registry import DECODE_ERRORS, Decoder
from voodoo_jax.io.frame_sync import clean_stamps
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.measuring import Measured, Measuring
from voodoo_jax.io.pictures import PictureReader
from voodoo_jax.io.pose_rays import PoseRays
from voodoo_jax.io.read_plan import Plan
from voodoo_jax.io.repeats import Repeats
from voodoo_jax.io.stereo_pairs import StereoReader
from voodoo_jax.records.messages import Cloud, Image
from voodoo_jax.records.recording import NO_PAIRS, NO_RAYS, Frame, Picture, joined_rays

AHEAD = 2 * UNPACKERS  # frames: so that no thread waits for the next pair of images
Part = tuple[int, int, Measured | Future[Cloud]]  # number of a sensor, and of its message; a pair's is being matched
UNREADABLE = "cannot be decoded, left out"
STUCK = "left out, which repeat the previous image: the sensor, its driver or a relay was frozen"


class FramePass:
    """One pass over a log. `counted` has what happened with messages, `error` why the first one cannot be read, and
    `made` the number of frames so far."""

    # 8 parameters: what the first pass found, and what outlives this one
    def __init__(
        self,
        scan: Scan,
        plan: Plan,
        settings: ReadSettings,
        measuring: Measuring,
        decoder: Decoder,
        repeats: Repeats,
        counted: Counter[tuple[str, str]],
        origins: Float[np.ndarray, "sensor 3"],
    ):
        self.counted, self.error, self.made = counted, "", 0
        self._scan, self._plan, self._settings, self._measuring = scan, plan, settings, measuring
        self._decoder, self._repeats, self._origins = decoder, repeats, origins
        self._sensors = {name: i for i, name in enumerate(plan.sensors)}
        self._frame_of = {member: i for i, (_, members) in enumerate(plan.frames) for member in members}
        self._parts: dict[int, list[Part]] = {}
        self._pictures: dict[int, list[Picture]] = {}
        self._pose = PoseRays(settings.pose_net, plan.parts, counted) if settings.pose_net else None
        self._reader = PictureReader(scan, plan.fixed_frame, plan.pictures.cameras if plan.pictures else {})
        pairs = [pair for pair in scan.stereo if pair.left in self._sensors]
        self._stereo = StereoReader(scan.topics, scan.tree, pairs, settings)
        plan.parts.forget()

    def frames(self) -> Iterator[Frame]:
        """Frames in the order of their stamps, see LogReader.frames."""
        scan, plan, stereo = self._scan, self._plan, self._stereo
        extra = plan.pictures.frame_of if plan.pictures is not None else {}
        missing = [len(members) for _, members in plan.frames]
        for i in extra.values():
            missing[i] += 1
        used = {*self._sensors, *stereo.rights, *(name for name, _ in extra)}
        following = complete = 0
        ahead = AHEAD if stereo.pairs else 0  # frames whose images are matched while those before are used
        for topic, number, item, partner in stereo.items(scan.numbered(used)):
            if (topic, number) in extra:
                i = extra[topic, number]
                missing[i] -= 1
                self._keep(i, topic, partial(self._reader.single, item, self._picture_stamp(topic, number)))
                continue
            i = self._frame_of.get((self._sensors.get(topic, -1), number))
            if i is None or item[0] is None:
                continue
            scan.log.clock.check()
            missing[i] -= 1
            try:
                self._take(i, topic, number, item, partner)
            except DECODE_ERRORS as problem:
                self._broken(topic, problem)
            while complete < len(missing) and missing[complete] == 0:
                complete += 1
            while following < complete - ahead:
                yield from self._complete(following)
                following += 1
        # What follows the last depth message; of frames with depth only if the file was changed between the passes.
        for i in range(following, len(missing)):
            yield from self._complete(i)

    def _take(self, i: int, topic: str, number: int, item: Item, partner: Item | None) -> None:
        """Decodes a message for a frame, or begins to match a pair's images. Raises DECODE_ERRORS."""
        sensor, (schema, channel, message) = self._sensors[topic], item
        assert schema is not None  # see frames
        part = None
        if topic not in self._stereo.pairs:
            part = self._measured(sensor, number, self._decoder.message(schema, channel, message.data))
        elif partner is None:
            self.counted[topic, "left out, without an image of the other camera at the same time"] += 1
        else:
            if self._plan.pictures is not None:
                stamp, pair = int(self._plan.stamps[sensor][number]), self._stereo.pairs[topic]
                self._keep(i, topic, partial(self._reader.pair, item, partner, pair, stamp))
            if self._settings.matching == "none":
                self._parts.setdefault(i, [])
            else:
                part = self._stereo.begin(item, partner, self._plan.fixed_frame, self._plan.up)
        if part is not None:
            self._parts.setdefault(i, []).append((sensor, number, part))

    def _measured(self, sensor: int, number: int, content: Cloud | Image) -> Measured | None:
        """What a message measured; None if it repeats the one before it, or cannot be used."""
        topic = self._plan.sensors[sensor]
        if self._repeats.again(topic, content):
            self.counted[topic, STUCK] += 1
            return None
        return self._measuring.measured(topic, content, int(self._plan.stamps[sensor][number]), self.counted)

    def _complete(self, i: int) -> Iterator[Frame]:
        """A frame once the images of stereo pairs are matched; none if no depth message of it can be used."""
        parts = self._parts.pop(i, None)
        found = [] if parts == [] or not self._plan.led_by_points else None
        for sensor, number, part in parts or ():
            if isinstance(part, Future):
                try:
                    part = self._measured(sensor, number, part.result())
                except DECODE_ERRORS as problem:
                    self._broken(self._plan.sensors[sensor], problem)
                    continue
            if part is not None:
                found = [*(found or ()), (sensor, part)]
        if found is not None:
            yield self._frame(i, found)
            self.made += 1
            self._scan.log.clock.restart()

    def _broken(self, topic: str, problem: Exception) -> None:
        """Counts a message that cannot be read, and keeps why the first one cannot."""
        self.error = self.error or f"{type(problem).__name__}: {problem}"
        self.counted[topic, UNREADABLE] += 1

    def _frame(self, i: int, parts: list[tuple[int, Measured]]) -> Frame:
        plan, origins, time_ns = self._plan, self._origins, self._plan.frames[i][0]
        for sensor, measured in parts:
            origins[sensor] = measured.origin
        for sensor in np.flatnonzero(np.isnan(origins[:, 0])):  # sensors that have not measured yet
            frame = self._scan.topics[plan.sensors[sensor]].sample.frame
            found = self._scan.tree.lookup(plan.fixed_frame, frame, time_ns, hold_ns=None)
            origins[sensor] = found[1] if found else 0.0
        parts = sorted(parts, key=lambda part: part[0])
        sizes = [len(m.points) for _, m in parts]
        sensor = np.repeat(np.array([s for s, _ in parts], np.int32), sizes)
        clouds = [m.points for _, m in parts] or [np.zeros((0, 3), np.float32)]
        points = clouds[0] if len(clouds) == 1 else np.concatenate(clouds)
        labels = plan.parts
        part = np.concatenate([np.zeros(0, np.int32), *(m.part for _, m in parts)]) if labels.names else None
        weights = np.array([labels.weight(name) for name in plan.sensors], np.float32)
        rays, pictures = plan.rays.get(i, NO_RAYS), tuple(self._pictures.pop(i, ()))
        if self._pose is not None:
            rays = joined_rays([rays, self._pose.rays(pictures)])
        return Frame(
            time_ns=time_ns,
            points=points.astype(np.float32, order="F", copy=False),  # by coordinate in memory, see Measuring
            sensor=sensor,
            origins=origins.astype(np.float32),
            rays=rays,
            pairs=plan.pairs.get(i, NO_PAIRS),
            part=part,
            parts=labels.names,
            weight=weights[sensor] if labels.weighted(plan.sensors) else None,
            pictures=pictures if self._settings.images else (),
            matched=bool(parts) and {plan.sensors[k] for k, _ in parts} <= {pair.left for pair in self._scan.stereo},
        )

    def _picture_stamp(self, topic: str, number: int) -> int:
        """When a message of a single camera was taken, nanoseconds."""
        found = self._scan.topics[topic]
        return int(clean_stamps(topic, found.stamps, found.log_times, [])[number])

    def _keep(self, frame: int, topic: str, make: Callable[[], Picture | None]) -> None:
        """Puts a picture into its frame, or counts why there is none."""
        try:
            picture = make()
        except DECODE_ERRORS:
            self.counted[topic, "with an image that cannot be decoded, which is left out"] += 1
            return
        if picture is None:
            self.counted[topic, "with an image left out, for which there is no transform"] += 1
        else:
            self._pictures.setdefault(frame, []).append(picture)
