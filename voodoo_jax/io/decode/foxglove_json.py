"""Converts Foxglove messages in JSON to the protobuf messages of the same name."""

import json
from datetime import UTC, datetime
from functools import lru_cache
from importlib import import_module
from typing import Any

from google.protobuf import json_format
from google.protobuf.message import Message


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
