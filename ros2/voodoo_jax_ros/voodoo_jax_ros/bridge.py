"""Between ROS messages and voodoo_jax's live tracking; knows neither rclpy nor a running ROS."""

import math
import queue
import threading
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from mcap.records import Channel, Message, Schema
from rosbags.typesys import Stores, TypesysError, get_typestore

from voodoo_jax.batch.live import LiveJob, track_live
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.config.options import Settings
from voodoo_jax.config.presets import online
from voodoo_jax.config.toml import settings_from
from voodoo_jax.io.container import Item
from voodoo_jax.io.decode.registry import kind_of
from voodoo_jax.records.tracks import Tracks

OWN = "voodoo/"  # with which the frames begin that are given out
COLOURS = {"l": (0.93, 0.42, 0.25), "r": (0.30, 0.55, 0.95), "": (0.75, 0.76, 0.78)}  # left, right, middle
JOINT = 0.03  # metres, diameter of a joint's marker
OK, WARN, ERROR = b"\0", b"\1", b"\2"  # levels of DiagnosticStatus
CYLINDER, SPHERE_LIST, DELETE = 3, 7, 2  # of Marker
Make = Callable[..., Any]  # make("geometry_msgs/msg/Point", x=..., y=..., z=...): a message


class TopicSource:
    """A source (voodoo_jax.io.live.sources.Source) of messages that a node hands over as they come, still packed."""

    def __init__(self, name: str = "ros"):
        self.path, self.ended, self.notes = name, False, list[str]()
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._known: dict[tuple[str, str], tuple[Schema, Channel]] = {}
        self._come: queue.SimpleQueue[Item] = queue.SimpleQueue()

    def wants(self, topic: str, kind: str) -> bool:
        """Whether messages of a topic are of use, by the name of their type (sensor_msgs/msg/Image)."""
        return self._described(topic, kind) is not None

    def receive(self, topic: str, kind: str, data: bytes, stamp_ns: int) -> None:
        """Takes a message as it came (CDR), and when."""
        described, data = self._described(topic, kind), bytes(data)
        if described is None or (kind.endswith("TFMessage") and OWN.encode() in data):  # what this node gave out
            return
        schema, channel = described
        self._come.put((schema, channel, Message(channel.id, stamp_ns, data, stamp_ns, 0)))

    def poll(self, seconds: float) -> list[Item]:
        found = []
        try:
            found.append(self._come.get(timeout=seconds))
            while True:
                found.append(self._come.get_nowait())
        except queue.Empty:
            return found

    def close(self) -> None:
        self.ended = True

    def _described(self, topic: str, kind: str) -> tuple[Schema, Channel] | None:
        if (topic, kind) not in self._known:
            number = len(self._known) + 1
            try:
                text = self._store.generate_msgdef(kind)[0].encode()
            except (TypesysError, KeyError):  # a type of somebody else's package
                return None
            schema = Schema(id=number, name=kind, encoding="ros2msg", data=text)
            channel = Channel(id=number, topic=topic, message_encoding="cdr", metadata={}, schema_id=number)
            self._known[topic, kind] = schema, channel
        schema, channel = self._known[topic, kind]
        return (schema, channel) if kind_of(schema, channel) else None


class Given:
    """A publisher (voodoo_jax.exporters.foxglove.Publisher) that makes ROS messages of each frame.

    **Arguments:** `make` makes a message of a type by its name and fields; `publish` takes what it is ("tf", "body",
    "diagnostics") and the message.
    """

    def __init__(self, make: Make, publish: Callable[[str, Any], None]):
        self._make, self._publish = make, publish

    def frame(self, tracks: Tracks) -> None:
        header = self._header(tracks)
        self._publish("tf", self._make("tf2_msgs/msg/TFMessage", transforms=self._transforms(tracks, header)))
        self._publish("body", self._make("visualization_msgs/msg/MarkerArray", markers=self._markers(tracks, header)))
        status = self._make("diagnostic_msgs/msg/DiagnosticStatus", **self._status(tracks))
        self._publish("diagnostics", self._make("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[status]))

    def close(self) -> None:
        pass

    def _header(self, tracks: Tracks) -> Any:
        seconds, rest = divmod(int(tracks.time_ns[0]), 1_000_000_000)
        stamp = self._make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=tracks.fixed_frame)

    def _transforms(self, tracks: Tracks, header: Any) -> list[Any]:
        found, t = [], tracks.body.topology
        unturned = np.array([1.0, 0, 0, 0])
        parts = [(OWN + name, q, p) for name, q, p in zip(t.limbs, tracks.rotation[0], tracks.translation[0])]
        parts += [(f"{OWN}joint/{name}", unturned, p) for name, p in zip(tracks.joint_names, tracks.joints[0])]
        for name, turn, place in parts:
            if np.isfinite(turn).all() and np.isfinite(place).all():
                transform = self._make(
                    "geometry_msgs/msg/Transform",
                    translation=self._xyz("Vector3", place), rotation=self._quaternion(turn),
                )  # fmt: skip
                found.append(
                    self._make(
                        "geometry_msgs/msg/TransformStamped", header=header, child_frame_id=name, transform=transform
                    )
                )
        return found

    def _markers(self, tracks: Tracks, header: Any) -> list[Any]:
        """A cylinder for each limb, and a ball for each joint, the redder the more doubtful."""
        found, t = [], tracks.body.topology
        for i, (name, (a0, b0, a1, b1, length)) in enumerate(zip(t.limbs, np.asarray(tracks.body.sizes, float))):
            turn, place = tracks.rotation[0, i].astype(float), tracks.translation[0, i].astype(float)
            there = bool(np.isfinite(turn).all() and np.isfinite(place).all())
            w, x, y, z = turn if there else (1.0, 0, 0, 0)
            axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
            middle = place + axis * length / 2 if there else np.zeros(3)
            pose = self._make(
                "geometry_msgs/msg/Pose",
                position=self._xyz("Point", middle), orientation=self._quaternion((w, x, y, z)),
            )  # fmt: skip
            colour = self._colour(*COLOURS[name[0] if name[:2] in ("l_", "r_") else ""], 0.8)
            scale = self._xyz("Vector3", (a0 + a1, b0 + b1, length))
            found.append(self._marker(header, "limbs", i, CYLINDER if there else -1, pose, scale, colour))
        sure = np.ones(len(t.centres)) if tracks.joint_confidence is None else tracks.joint_confidence[0]
        known = np.isfinite(tracks.joints[0]).all(1)
        points = [self._xyz("Point", p) for p in tracks.joints[0][known]]
        shades = [self._colour(1.0, *2 * [float(s) if math.isfinite(s) else 1.0], 1.0) for s in sure[known]]
        pose = self._make(
            "geometry_msgs/msg/Pose",
            position=self._xyz("Point", (0, 0, 0)), orientation=self._quaternion((1.0, 0, 0, 0)),
        )  # fmt: skip
        scale, white = self._xyz("Vector3", (JOINT, JOINT, JOINT)), self._colour(1, 1, 1, 1)
        kind = SPHERE_LIST if points else -1
        return [*found, self._marker(header, "joints", 0, kind, pose, scale, white, points=points, colors=shades)]

    def _marker(
        self, header: Any, space: str, number: int, kind: int, pose: Any, scale: Any, color: Any, **more: Any
    ) -> Any:
        """`kind` -1: it is taken away."""
        lists: dict[str, Any] = {"points": [], "colors": []} | more
        return self._make(
            "visualization_msgs/msg/Marker", header=header, ns=space, id=number, type=max(kind, CYLINDER),
            action=DELETE if kind < 0 else 0, pose=pose, scale=scale, color=color, **lists,
        )  # fmt: skip

    def _status(self, tracks: Tracks) -> dict[str, Any]:
        sure, tracked = float(tracks.confidence[0]), bool(tracks.tracked[0])
        level, text = (OK, "tracked") if tracked else (WARN, "not tracked")
        values = {
            "residual_m": float(tracks.evidence.residual[0]),
            "explained": float(tracks.evidence.explained[0]),
            "confidence": sure,
        }
        pairs = [
            self._make("diagnostic_msgs/msg/KeyValue", key=key, value=f"{value:.4f}") for key, value in values.items()
        ]
        name = f"voodoo_jax: {tracks.body.name}"
        return {"level": level, "name": name, "message": text, "hardware_id": "", "values": pairs}

    def _xyz(self, kind: str, values: Any) -> Any:
        x, y, z = map(float, values)
        return self._make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _quaternion(self, wxyz: Any) -> Any:
        w, x, y, z = map(float, wxyz)
        return self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def _colour(self, r: float, g: float, b: float, a: float) -> Any:
        return self._make("std_msgs/msg/ColorRGBA", r=float(r), g=float(g), b=float(b), a=float(a))


def parameters(settings: Settings | None = None) -> dict[str, Any]:
    """All settings as parameters of a node, by section and name (detect.points), with their defaults: bool, int, float,
    text, lists of text (never empty: ROS cannot tell of what an empty one is)."""
    found: dict[str, Any] = {}
    settings = settings or Settings()
    for section in fields(settings):
        stage = getattr(settings, section.name)
        if is_dataclass(stage):
            for option in fields(stage):
                value = getattr(stage, option.name)
                if isinstance(value, tuple) and all(isinstance(v, str) for v in value):
                    value = list(value) or [""]
                if isinstance(value, bool | int | float | str) or (isinstance(value, list) and value):
                    found[f"{section.name}.{option.name.replace('_', '-')}"] = value
    return found


def settings_of(values: dict[str, Any]) -> Settings:
    """Settings of a node's parameters; those that are as they were by default are left to it. Raises SettingsError."""
    content: dict[str, dict[str, Any]] = {}
    for name, default in parameters().items():
        value = values.get(name, default)
        value = [v for v in value if v] if isinstance(value, list) else value
        if value != ([v for v in default if v] if isinstance(default, list) else default):
            section, _, option = name.partition(".")
            content.setdefault(section, {})[option.replace("-", "_")] = value
    return online(settings_from(content, Settings(), "parameters"))


class Session:
    """Tracking in a thread of its own, from the first message until `end`."""

    def __init__(self, source: TopicSource, job: LiveJob, given: list[Any], say: Callable[[str], None]):
        self.source, self.outcome, self._say = source, None, say
        self.problem = ""  # why it ended of itself
        self._thread = threading.Thread(target=self._run, args=(job, given, say), daemon=True)
        self._thread.start()

    outcome: Outcome | None

    def _run(self, job: LiveJob, given: list[Any], say: Callable[[str], None]) -> None:
        try:
            self.outcome = track_live(job, self.source, given, say, say)
        except Exception as problem:  # a node says it, and lives on
            self.problem = f"{type(problem).__name__}: {problem}"
            say(self.problem)

    def end(self, seconds: float = 600.0) -> bool:
        """Lets it track what has come, and write its results, for `seconds` at most; whether it has ended."""
        self.source.ended = True
        for _ in range(max(1, round(seconds / 15))):
            self._thread.join(15.0)
            if not self._thread.is_alive():
                return True
            self._say("still tracking the frames received so far; results are written after that")
        return False
