"""Tracks as an MCAP file for Foxglove: frames, poses, the body, quality, and the parameters; and published frame by
frame: a growing file, and a Foxglove WebSocket server.

Frames: `voodoo/<limb>` (the limb frame of model/body.py) and `voodoo/joint/<name>`, both in the tracks' fixed frame.
"""

import colorsys
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp
from jaxtyping import Bool, Float, Float32
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from voodoo_jax._version import __version__
from voodoo_jax.exporters.limb_shapes import loft, profile
from voodoo_jax.model.body import Body
from voodoo_jax.model.body_file import format_body
from voodoo_jax.records.tracks import Status, Tracks
from voodoo_jax.storage.atomic import begun, moved, replacing

CHUNK = 1 << 14  # bytes of the file after which a chunk is closed, that a reader may have it: some frames; by hand
SCENE_PERIOD_NS = 1_000_000_000  # the body is written again this often, for readers that seek without looking back
SAME_RATIO = 0.02  # ends whose axis ratios differ less are one CylinderPrimitive
QUALITY_SCHEMA = {
    "title": "voodoo_jax.Quality",
    "type": "object",
    "properties": {
        "residual_m": {"type": ["number", "null"], "description": "root mean square distance of the used points, m"},
        "explained": {"type": ["number", "null"], "description": "share of the person's points that the body explains"},
        "confidence": {"type": ["number", "null"], "description": "share of the joints expected to be within 10 cm"},
        "steps": {"type": "integer"},
        "tracked": {"type": "boolean"},
        "status": {"type": "integer", "description": ", ".join(f"{s.value} {s.name}" for s in Status)},
    },
}


@runtime_checkable
class Publisher(Protocol):
    """Takes tracks of one frame each."""

    def frame(self, tracks: Tracks) -> None: ...
    def close(self) -> None: ...


class GrowingTracks:
    """A `.voodoo.mcap` file that can be read while it is written, in Foxglove or by another program. It replaces an
    earlier one with its first frame; without a frame, nothing changes. Raises OSError."""

    def __init__(self, path: str | os.PathLike[str]):
        self._target, self._partial = Path(path), begun(path)
        self._file = open(self._partial, "wb")
        self._writer, self._said, self._count = Writer(self._file, chunk_size=CHUNK), BodyMessages(), 0
        self._writer.start(profile="", library="voodoo_jax live")
        self._channel = register_channels(self._writer, self._said)

    def frame(self, tracks: Tracks) -> None:
        """Takes one more frame."""
        stamp, data = int(tracks.time_ns[0]), self._said.of(tracks, 0, float(tracks.confidence[0]))
        for name, message in data.items():
            self._writer.add_message(self._channel[name], stamp, message, stamp, self._count)
        self._file.flush()
        if not self._count:
            moved(self._partial, self._target)
        self._count += 1

    def close(self) -> None:
        try:
            self._writer.finish()
        finally:
            with suppress(OSError):  # its disk is full, which was said
                self._file.close()
            self._partial.unlink(missing_ok=True)


class FoxgloveServer:
    """A server for Foxglove, or any program with its protocol. Raises ImportError without foxglove-sdk, OSError if the
    port is not available."""

    def __init__(self, port: int, host: str = "127.0.0.1"):
        foxglove: Any = import_module("foxglove")
        self._said, self._context = BodyMessages(), foxglove.Context()
        try:
            self._server = foxglove.start_server(name="voodoo-jax", host=host, port=port, context=self._context)
        except RuntimeError as problem:
            raise OSError(f"no server at {host}:{port}: {problem}") from problem
        self.url = f"ws://{host}:{self._server.port}"
        self._channel: dict[str, Any] = {}
        for content, topic in self._said.channels().items():
            name, how, data, encoding = schema_of(content)
            schema = foxglove.Schema(name=name, encoding=how, data=data)
            channel = foxglove.Channel(topic, schema=schema, message_encoding=encoding, context=self._context)
            self._channel[content] = channel

    def frame(self, tracks: Tracks) -> None:
        """Takes one more frame."""
        stamp = int(tracks.time_ns[0])
        for name, message in self._said.of(tracks, 0, float(tracks.confidence[0])).items():
            self._channel[name].log(message, log_time=stamp)

    def close(self) -> None:
        self._server.stop()


def write_tracks_mcap(
    tracks: Tracks | Sequence[Tracks], path: str | os.PathLike, parameters: dict[str, str] | None = None
) -> None:
    """Writes `.voodoo.mcap`; log times are the frames' stamps, lengths metres, all in the tracks' fixed frame.

    **Arguments:** `tracks` of one person, or of everybody in a recording: topics, frames and the attached body file of
    person 2 have /2 in their names (/voodoo/2/tf, voodoo/2/torso, body.2.toml), and so on; `parameters` for the record.

    Topics: /voodoo/tf (FrameTransforms, limbs and joint centres), /voodoo/poses (PosesInFrame, limbs in the order of
    the body), /voodoo/body (SceneUpdate), /voodoo/joints (PointCloud of the joint centres with their confidence, for
    Rerun, which draws nothing of the others), /voodoo/quality (JSON). Frames without poses have quality only. Metadata
    record `voodoo_jax`: version, source, fixed_frame and `parameters`; attachment `body.toml`: the body file.
    The file appears under its name only when complete. Raises OSError.
    """
    with replacing(path) as partial, open(partial, "wb") as file:
        writer = Writer(file)
        writer.start(profile="", library=f"voodoo_jax {__version__}")
        people = [tracks] if isinstance(tracks, Tracks) else list(tracks)
        first = people[0]
        start = int(first.time_ns[0]) if len(first.time_ns) else 0
        own = {"version": __version__, "source": first.source, "fixed_frame": first.fixed_frame}
        writer.add_metadata("voodoo_jax", (parameters or {}) | own)
        for one in people:
            name = "body.toml" if one.person == 1 else f"body.{one.person}.toml"
            writer.add_attachment(start, start, name, "application/toml", format_body(one.body).encode())
        # frame by frame, so that readers need not look back
        for messages in zip(*(_messages(writer, one) for one in people), strict=True):
            for channel, stamp, data, number in chain.from_iterable(messages):
                writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp, sequence=number)
        writer.finish()


def _prefix(person: int) -> str:
    """Prefix of all names that belong to a person."""
    return "voodoo/" if person == 1 else f"voodoo/{person}/"


TOPICS = {"tf": FrameTransforms, "poses": PosesInFrame, "body": SceneUpdate, "joints": PointCloud}


class BodyMessages:
    """Messages of one person, frame by frame: of successive frames of one Tracks, or of Tracks of one frame each."""

    def __init__(self, person: int = 1):
        self._prefix = _prefix(person)
        self._tracks: Tracks | None = None
        self._body: Body | None = None  # that is shown
        self._next_scene: int | None = None
        self._shown: frozenset[str] = frozenset()

    def channels(self) -> dict[str, str]:
        """Topics by content: the names of TOPICS, and "quality"."""
        return {name: f"/{self._prefix}{name}" for name in (*TOPICS, "quality")}

    def of(self, tracks: Tracks, i: int, confidence: float) -> dict[str, bytes]:
        """Messages of frame `i` by content; `confidence` as in Tracks."""
        if tracks.body is not self._body:
            self._entities, self._named = body_entities(tracks.body, tracks.person), _named(tracks)
            self._cloud = _joint_cloud(tracks)
            self._body, self._next_scene = tracks.body, None
        if tracks is not self._tracks:
            self._tracks, (self._points, self._there) = tracks, _joint_points(tracks)
        stamp = int(tracks.time_ns[i])
        seconds, nanos = divmod(stamp, 1_000_000_000)
        time = Timestamp(seconds=seconds, nanos=nanos)
        messages = {"quality": quality_of(tracks, i, confidence)}
        transforms = _transforms(tracks, i, time, self._named)
        if not transforms:
            return messages
        messages["tf"] = FrameTransforms(transforms=transforms).SerializeToString()
        limbs = [t for t in transforms if not t.child_frame_id.startswith(f"{self._prefix}joint/")]
        poses = [Pose(position=t.translation, orientation=t.rotation) for t in limbs]
        if len(poses) == tracks.body.limb_count:  # a list with gaps would name the wrong limbs
            message = PosesInFrame(timestamp=time, frame_id=tracks.fixed_frame, poses=poses)
            messages["poses"] = message.SerializeToString()
        self._cloud.timestamp.CopyFrom(time)
        self._cloud.data = self._points[i][self._there[i]].tobytes()
        messages["joints"] = self._cloud.SerializeToString()
        there = frozenset(t.child_frame_id.removeprefix(self._prefix) for t in limbs)
        if self._next_scene is None or stamp >= self._next_scene or there != self._shown:
            messages["body"] = self._scene(there, stamp, time).SerializeToString()
        return messages

    def _scene(self, there: frozenset[str], stamp: int, time: Timestamp) -> SceneUpdate:
        """The limbs that have a pose."""
        self._next_scene = stamp + SCENE_PERIOD_NS
        update = SceneUpdate(entities=[e for e in self._entities if e.id in there])
        # a limb that was taken off, or a thing that was put down
        gone = sorted(self._shown - there)
        update.deletions.extend(SceneEntityDeletion(id=name, timestamp=time) for name in gone)
        for entity in update.entities:
            entity.timestamp.CopyFrom(time)
        self._shown = there
        return update


def schema_of(name: str) -> tuple[str, str, bytes, str]:
    """Name, encoding and content of the schema of a kind of messages (of BodyMessages.channels), and their encoding."""
    if name not in TOPICS:
        return "voodoo_jax.Quality", "jsonschema", json.dumps(QUALITY_SCHEMA).encode(), "json"
    data = build_file_descriptor_set(TOPICS[name]).SerializeToString()
    return TOPICS[name].DESCRIPTOR.full_name, "protobuf", data, "protobuf"


def register_channels(writer: Writer, said: BodyMessages) -> dict[str, int]:
    """Numbers of a person's channels in a file, by content."""
    numbers = {}
    for name, topic in said.channels().items():
        schema, how, data, encoding = schema_of(name)
        numbers[name] = writer.register_channel(topic, encoding, writer.register_schema(schema, how, data))
    return numbers


def _messages(writer: Writer, tracks: Tracks) -> Iterator[list[tuple[int, int, bytes, int]]]:
    """Channel, stamp, content and number of the messages of each frame."""
    said = BodyMessages(tracks.person)
    channel, confidence = register_channels(writer, said), tracks.confidence.tolist()
    for i, stamp in enumerate(tracks.time_ns.tolist()):
        yield [(channel[name], stamp, data, i) for name, data in said.of(tracks, i, confidence[i]).items()]


def _joint_points(tracks: Tracks) -> tuple[Float32[np.ndarray, "frame joint 4"], Bool[np.ndarray, "frame joint"]]:
    """Joint centres and their confidence, as in _joint_cloud, and a mask of those that exist."""
    sure = np.ones(tracks.joints.shape[:2]) if tracks.joint_confidence is None else tracks.joint_confidence
    return np.concatenate([tracks.joints, sure[..., None]], -1).astype("<f4"), np.all(np.isfinite(tracks.joints), -1)


def _joint_cloud(tracks: Tracks) -> PointCloud:
    """A message of joint centres as points, still without time and positions."""
    kind = PackedElementField.FLOAT32
    names = ("x", "y", "z", "confidence")
    fields = [PackedElementField(name=name, offset=4 * k, type=kind) for k, name in enumerate(names)]
    cloud = PointCloud(frame_id=tracks.fixed_frame, point_stride=16, fields=fields)
    cloud.pose.orientation.w = 1
    return cloud


def _named(tracks: Tracks) -> list[FrameTransform]:
    """A transform for each limb and joint centre, still without time and pose."""
    prefix = _prefix(tracks.person)
    names = [f"{prefix}{name}" for name in tracks.body.topology.limbs]
    names += [f"{prefix}joint/{name}" for name in tracks.joint_names]
    return [FrameTransform(parent_frame_id=tracks.fixed_frame, child_frame_id=name) for name in names]


def _transforms(tracks: Tracks, frame: int, time: Timestamp, named: list[FrameTransform]) -> list[FrameTransform]:
    """Poses of limbs and joint centres in one frame, written into `named`: creating new messages takes several times as
    long. NaN poses are left out."""
    turns = np.tile(np.array([1.0, 0, 0, 0]), (len(named), 1))
    turns[: tracks.body.limb_count] = tracks.rotation[frame]
    places = np.concatenate([tracks.translation[frame], tracks.joints[frame]]).astype(float)
    there = np.all(np.isfinite(np.concatenate([turns, places], 1)), axis=1).tolist()
    for transform, p, q, use in zip(named, places.tolist(), turns.tolist(), there):
        if use:
            transform.timestamp.CopyFrom(time)
            at, turn = transform.translation, transform.rotation
            at.x, at.y, at.z = p
            turn.w, turn.x, turn.y, turn.z = q
    return [transform for transform, use in zip(named, there) if use]


def quality_of(tracks: Tracks, frame: int, confidence: float) -> bytes:
    number = lambda x: float(x) if math.isfinite(x) else None  # noqa: E731  (JSON has no NaN)
    scalars = {
        "residual_m": number(tracks.evidence.residual[frame]),
        "explained": number(tracks.evidence.explained[frame]),
        "confidence": number(confidence),
        "steps": int(tracks.evidence.steps[frame]),
        "tracked": bool(tracks.status[frame] == Status.TRACKED),
        "status": int(tracks.status[frame]),
    }
    return json.dumps(scalars, allow_nan=False).encode()


def body_entities(body: Body, person: int = 1) -> list[SceneEntity]:
    """One SceneEntity per limb, id = limb name, in the frame `voodoo/<limb>` that it moves with (`voodoo/2/<limb>` of
    person 2); no timestamp. The main person's limbs differ in colour; each other person has one colour. Metadata of
    each entity: a0, b0, a1, b1, length in metres, as in Body.sizes.
    """
    entities = []
    for i, (name, sizes) in enumerate(zip(body.topology.limbs, np.asarray(body.sizes, float))):
        entity = SceneEntity(id=name, frame_id=f"{_prefix(person)}{name}", frame_locked=True, lifetime=Duration())
        for key, value in zip(("a0", "b0", "a1", "b1", "length"), sizes):
            entity.metadata.append(KeyValuePair(key=key, value=f"{value:.9g}"))
        # golden ratio steps keep the colours of neighbours apart
        hue, bright = (i, 0.95) if person == 1 else (person, 0.95 - 0.3 * (i * 0.618 % 1))
        r, g, b = colorsys.hsv_to_rgb(hue * 0.618 % 1, 0.55, bright)
        color = Color(r=r, g=g, b=b, a=0.7)
        a0, b0, a1, b1, _ = sizes
        rings = profile(body, i)
        if len(rings) == 2 and abs(a0 * b1 / (a1 * b0) - 1) < SAME_RATIO:
            entity.cylinders.append(_cylinder(sizes, color))
        else:
            entity.triangles.append(_triangles(rings, color))
        entities.append(entity)
    return entities


def _cylinder(sizes: Float[np.ndarray, "5"], color: Color) -> CylinderPrimitive:
    a0, b0, a1, b1, length = sizes.tolist()
    # `size` is the bounding box, so that of the wider end; the ratio of the ends is the same along x and y here
    ratio = math.sqrt(a1 * b1 / (a0 * b0))
    a, b = (a0, b0) if ratio <= 1 else (a1, b1)
    return CylinderPrimitive(
        # the primitive is centred, the limb frame sits in the bottom ellipse
        pose=Pose(position=Vector3(z=length / 2), orientation=Quaternion(w=1)),
        size=Vector3(x=2 * a, y=2 * b, z=length),
        bottom_scale=min(1.0, 1 / ratio),
        top_scale=min(1.0, ratio),
        color=color,
    )


def _triangles(rings: Float[np.ndarray, "ring 3"], color: Color) -> TriangleListPrimitive:
    vertices, faces = loft(rings)
    return TriangleListPrimitive(
        pose=Pose(position=Vector3(), orientation=Quaternion(w=1)),
        points=[Point3(x=x, y=y, z=z) for x, y, z in vertices.tolist()],
        indices=faces.ravel().tolist(),
        color=color,
    )
