"""Decodes the bytes of ROS 2 and Foxglove messages: the table of supported types and their decoders."""

import json
import re
import struct
from collections.abc import Callable
from datetime import UTC, datetime
from functools import lru_cache
from importlib import import_module
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import DecodeError as ProtobufError
from google.protobuf.message import Message
from mcap.exceptions import McapError
from mcap.records import Channel, Schema
from mcap_protobuf.decoder import DecoderFactory
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from voodoo_jax.config.limited import limits, too_large
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.io.decode import depth, image_codec, landmarks, packed_cloud
from voodoo_jax.io.decode.by_fields import by_fields, starts_with_header
from voodoo_jax.io.decode.landmark_layout import Remembering
from voodoo_jax.records.messages import PAIRS, RAYS

DEPTH_KINDS = ("image", "point cloud", "laser scan")
FEATURE_KINDS = (RAYS, PAIRS)
# what the messages of each type are used for, and what converts them
_TYPES: dict[str, tuple[str, Callable[[Any], Any]]] = (
    depth.CONVERTERS | packed_cloud.CONVERTERS | image_codec.CONVERTERS | landmarks.CONVERTERS
)
KINDS = {name: kind for name, (kind, _) in _TYPES.items()}
_ENCODINGS = {
    ("cdr", "ros2msg"), ("cdr", "ros2idl"), ("ros1", "ros1msg"), ("protobuf", "protobuf"), ("json", "jsonschema"),
}  # fmt: skip
KEPT = 1024  # schemas of which it is remembered what they are good for: robots record some hundred
_OLD_NAMES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}  # of ROS 1
# One broken message raises one of these in rosbags, protobuf or NumPy.
DECODE_ERRORS = (
    SerdeError,
    TypesysError,
    ProtobufError,
    McapError,
    struct.error,
    ValueError,  # also UnicodeDecodeError
    TypeError,
    LookupError,
    AttributeError,
    AssertionError,
    OverflowError,
    MemoryError,
    RecursionError,
)


@lru_cache(64)
def _kind(name: str) -> type[Message]:
    short = name.rsplit(".", 1)[-1]
    try:
        return getattr(import_module(f"foxglove_schemas_protobuf.{short}_pb2"), short)
    except ImportError as problem:
        raise ValueError(f"{name} is not a Foxglove message") from problem


def message_of(name: str, data: bytes) -> Message:
    """The message with a name such as foxglove.PointCloud. Raises ValueError for other data."""
    try:
        return json_format.ParseDict(_as_protobuf(json.loads(data)), _kind(name)(), ignore_unknown_fields=True)
    except (json_format.ParseError, OSError, OverflowError) as problem:
        raise ValueError(str(problem)) from problem


def _as_protobuf(value: Any, key: str = "") -> Any:
    """Times as protobuf has them in JSON: Foxglove writes {"sec": 1, "nsec": 2}."""
    if isinstance(value, list):
        return [_as_protobuf(item) for item in value] if value and isinstance(value[0], dict | list) else value
    if not isinstance(value, dict):
        return value
    if "sec" in value and value.keys() <= {"sec", "nsec", "nanosec"}:
        part = f"{int(value.get('nsec', value.get('nanosec', 0))):09d}"
        if key == "lifetime":
            return f"{int(value['sec'])}.{part}s"
        return f"{datetime.fromtimestamp(int(value['sec']), UTC):%Y-%m-%dT%H:%M:%S}.{part}Z"
    return {name: _as_protobuf(item, name) for name, item in value.items()}


def kind_of(schema: Schema | None, channel: Channel) -> str:
    """The use of a channel: a value of `KINDS`, or "" for none."""
    if schema is None or (channel.message_encoding, schema.encoding) not in _ENCODINGS:
        return ""
    known = KINDS.get(_full(schema.name), "")
    return known or (_of_structure(schema)[0] if channel.message_encoding in ("cdr", "ros1") else "")


def reason_unused(schema: Schema | None, channel: Channel) -> str:
    """The reason why a channel is not read: its kind is unsupported or switched off."""
    if schema is None:
        return "it has no schema"
    name = schema.name.rsplit("/", 1)[-1].rsplit(".", 1)[-1]
    if (channel.message_encoding, schema.encoding) not in _ENCODINGS:
        return f"encoding {channel.message_encoding or '?'}/{schema.encoding or '?'} is not supported"
    if name == "CompressedImage":
        return "a colour image"
    if "Compressed" in name:
        return "videos are not read, nor clouds of other packages than point_cloud_transport"
    if name == "LaserScan":
        return "a single line of a laser scanner"
    return "no depth, calibration or transforms"


def is_static(channel: Channel) -> bool:
    """Whether transforms on this channel are static."""
    if channel.topic.rstrip("/").endswith("tf_static") or channel.metadata.get("latching") == "1":
        return True
    qos = channel.metadata.get("offered_qos_profiles", "")
    return re.search(r"durability:\s*(1\b|transient_local)", qos) is not None


class Decoder:
    """Decodes message bytes to `Cloud` (laser scans too), `Image`, `Colour`, `Calibration`, `Features` or a list of
    `Transform`; one decoder per schema."""

    def __init__(self):
        self._made: dict[tuple[str, bytes], Callable[[bytes], Any] | str] = {}

    def message(self, schema: Schema, channel: Channel, data: bytes) -> Any:
        """The decoded content. Raises one of DECODE_ERRORS if the message or its schema is damaged."""
        key = (schema.name, schema.data)
        if key not in self._made:
            self._made[key] = self._make(schema, channel)
        made = self._made[key]
        if isinstance(made, str):
            raise ValueError(made)
        return made(data)

    def _make(self, schema: Schema, channel: Channel) -> Callable[[bytes], Any] | str:
        """What decodes messages of a schema, or why nothing can: looked for once, not with each message."""
        make = {"protobuf": _protobuf, "json": _json}.get(channel.message_encoding)
        try:
            _check_size(schema.data)
            if make:
                return make(schema)
            found = _ros(schema.name, schema.encoding, schema.data, limits())
            return Remembering(found) if kind_of(schema, channel) == PAIRS else found
        except DECODE_ERRORS as problem:
            return str(problem) or type(problem).__name__


def _check_size(definition: bytes) -> None:
    """Raises ValueError for a schema that would take long to look through."""
    lines = definition.count(b"\n") + definition.count(b";") + definition.count(b"@")  # IDL needs no ends of lines
    if trouble := too_large("its schema has", len(definition), "schema_bytes") or too_large(
        "its schema has", lines, "schema_lines", "lines"
    ):
        raise ValueError(trouble)


def quick_stamp(schema: Schema, channel: Channel, data: bytes) -> int | None:
    """Header stamp of a ROS message that starts with std_msgs/Header, nanoseconds, without decoding the rest."""
    if channel.message_encoding not in ("cdr", "ros1"):
        return None
    if _full(schema.name) not in KINDS and not _of_structure(schema)[1]:
        return None
    if channel.message_encoding == "ros1" and len(data) >= 12:  # behind a sequence number
        seconds, nanoseconds = struct.unpack_from("<II", data, 4)
        return seconds * 1_000_000_000 + nanoseconds
    if channel.message_encoding != "cdr" or len(data) < 12:
        return None
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return seconds * 1_000_000_000 + nanoseconds


def _full(name: str) -> str:
    full = name if "/msg/" in name or "/" not in name else name.replace("/", "/msg/", 1)
    return _OLD_NAMES.get(full, full)


@lru_cache(64)  # logs of one robot have the same few, and each takes 10 ms
def _types(schema_name: str, encoding: str, definition: bytes, within: LimitSettings) -> tuple[Typestore, str]:
    """The types of a ROS schema, and the name of its own; `within`: the limits that hold, so that others count."""
    _check_size(definition)
    store, name, text = get_typestore(Stores.EMPTY), _full(schema_name), definition.decode()
    if encoding == "ros1msg":
        builtin = get_typestore(Stores.ROS1_NOETIC).fielddefs  # `time` and `duration` are no messages there
        times = {kind: builtin[kind] for kind in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")}
        store.register({**get_types_from_msg(text, name), **times})
    elif encoding == "ros2msg":
        store.register(get_types_from_msg(text, name))
    else:
        types = {}
        for part in re.split(r"^=+\r?\n", text, flags=re.MULTILINE):
            # The parser knows no preprocessor; what is included stands in another part anyway.
            body = re.sub(r"\A\s*IDL:[^\n]*\n|^\s*#[^\n]*$", "", part, flags=re.MULTILINE)
            if body.strip():
                types.update(get_types_from_idl(body))
        store.register(types)
    if trouble := too_large("its schema has", _fields(store, name, (), {}), "schema_fields", "fields"):
        raise ValueError(trouble)
    return store, name


def _fields(store: Typestore, name: str, above: tuple[str, ...], known: dict[str, int]) -> int:
    """Fields of a type with those of its fields: rosbags writes code for each. Raises ValueError for a type that holds
    itself."""
    if name in above:
        raise ValueError(f"its schema is damaged: {name} holds itself")
    if name not in known:
        count = 0
        fields: Any = store.fielddefs.get(name, ((), ()))[1]
        for _, (kind, content) in fields:
            if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                kind, content = content[0]
            count += 1 + (_fields(store, content, (*above, name), known) if kind == Nodetype.NAME else 0)
        known[name] = count
    return known[name]


@lru_cache(64)
def _ros(schema_name: str, encoding: str, definition: bytes, within: LimitSettings) -> Callable[[bytes], Any]:
    store, name = _types(schema_name, encoding, definition, within)
    convert = _TYPES[name][1] if name in _TYPES else by_fields(store, name)[1]
    if convert is None:
        raise ValueError(f"{name} has no usable field")
    read = store.deserialize_ros1 if encoding == "ros1msg" else store.deserialize_cdr
    return lambda data: convert(read(data, name))


def _of_structure(schema: Schema) -> tuple[str, bool]:
    """The use of a ROS message of an unknown type, by its fields, and whether it starts with a header."""
    return _structure(schema.name, schema.encoding, schema.data, limits())


@lru_cache(KEPT)
def _structure(schema_name: str, encoding: str, definition: bytes, within: LimitSettings) -> tuple[str, bool]:
    try:
        store, name = _types(schema_name, encoding, definition, within)
        return by_fields(store, name)[0], starts_with_header(store, name)
    except DECODE_ERRORS:
        return "", False


def _protobuf(schema: Schema) -> Callable[[bytes], Any]:
    decode = DecoderFactory().decoder_for("protobuf", schema)
    if decode is None:
        raise ValueError("not a protobuf schema")
    convert = _TYPES[schema.name][1]
    return lambda data: convert(decode(data))


def _json(schema: Schema) -> Callable[[bytes], Any]:
    convert = _TYPES[schema.name][1]
    return lambda data: convert(message_of(schema.name, data))
