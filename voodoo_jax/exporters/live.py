"""Tracks published frame by frame: a growing file, and a Foxglove WebSocket server."""

import json
import os
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from voodoo_jax.exporters.foxglove import QUALITY_SCHEMA, TOPICS, BodyMessages, register_channels
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import begun, moved

CHUNK = 1 << 14  # bytes of the file after which a chunk is closed, that a reader may have it: some frames; by hand


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
        self._channel = {name: self._made(foxglove, name, topic) for name, topic in self._said.channels().items()}

    def _made(self, foxglove: Any, name: str, topic: str) -> Any:
        if name in TOPICS:
            described = TOPICS[name].DESCRIPTOR
            data = build_file_descriptor_set(TOPICS[name]).SerializeToString()
            schema, encoding = foxglove.Schema(name=described.full_name, encoding="protobuf", data=data), "protobuf"
        else:
            text = json.dumps(QUALITY_SCHEMA).encode()
            schema, encoding = foxglove.Schema(name="voodoo_jax.Quality", encoding="jsonschema", data=text), "json"
        return foxglove.Channel(topic, schema=schema, message_encoding=encoding, context=self._context)

    def frame(self, tracks: Tracks) -> None:
        """Takes one more frame."""
        stamp = int(tracks.time_ns[0])
        for name, message in self._said.of(tracks, 0, float(tracks.confidence[0])).items():
            self._channel[name].log(message, log_time=stamp)

    def close(self) -> None:
        self._server.stop()
