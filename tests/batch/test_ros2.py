"""The node of ros2/ without ROS: its messages are those of rosbags, written to bytes and read back."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from tests.support.helpers import wait_for
from tests.support.small_logs import SETTINGS, small_log
from voodoo_jax.config.options import Settings
from voodoo_jax.exporters.npz import read_tracks_npz

FRAMES = 60  # at 20 Hz: tracking begins with what is there after two seconds
STORE = get_typestore(Stores.ROS2_HUMBLE)
BLANK = {"bool": False, "string": "", "float32": 0.0, "float64": 0.0}


def message(kind: str, **values: Any) -> Any:
    """A message as rclpy makes it: fields that are not named have nothing in them; read back from its bytes."""

    def blank(described: Any) -> Any:
        how, what = int(described[0]), described[1]
        if how == 1:  # a plain value
            return BLANK.get(what[0], 0)
        return message(what) if how == 2 else []

    given = {name: values[name] if name in values else blank(d) for name, d in STORE.fielddefs[kind][1]}
    for name, described in STORE.fielddefs[kind][1]:
        if described[1] == ("byte", 0) or described[1] == ("octet", 0):
            given[name] = given[name][0] if isinstance(given[name], bytes) else given[name]
        if int(described[0]) > 2 and int(described[1][0][0]) == 1 and described[1][0][1][0] != "string":
            given[name] = np.array(given[name], np.uint8)
    made = STORE.types[kind](**given)
    STORE.deserialize_cdr(STORE.serialize_cdr(made, kind), kind)
    return made


class Node:
    """What of rclpy's lifecycle node is used, without ROS."""

    def __init__(self, name: str):
        self.values: dict[str, Any] = {}
        self.topics: list[tuple[str, list[str]]] = []
        self.heard: dict[str, Any] = {}
        self.published: dict[str, list[Any]] = {}
        self.said: list[str] = []

    def declare_parameter(self, name: str, value: Any) -> None:
        assert isinstance(value, bool | int | float | str) or all(isinstance(v, str) for v in value)
        self.values.setdefault(name, value)

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.values[name])

    def get_logger(self) -> Any:
        return SimpleNamespace(info=self.said.append, error=self.said.append)

    def get_name(self) -> str:
        return "voodoo_jax"

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now))

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return self.topics

    def create_lifecycle_publisher(self, kind: Any, topic: str, depth: int) -> Any:
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def create_subscription(self, kind: Any, topic: str, take: Any, quality: Any, raw: bool) -> str:
        assert raw
        self.heard[topic] = take
        return topic

    def create_timer(self, seconds: float, call: Any) -> Any:
        return None

    def nothing(self, *_: Any) -> None:
        pass

    destroy_timer = destroy_publisher = nothing

    def destroy_subscription(self, topic: str) -> None:
        del self.heard[topic]

    def on_activate(self, state: Any) -> str:
        return "SUCCESS"

    on_deactivate = on_activate


@pytest.fixture
def node(monkeypatch) -> Iterator[Any]:
    names = SimpleNamespace(SUCCESS="SUCCESS", FAILURE="FAILURE")
    anything = SimpleNamespace(RELIABLE=0, BEST_EFFORT=1, TRANSIENT_LOCAL=2, VOLATILE=3)
    kept = {
        "rclpy": {}, "rosidl_runtime_py": {},
        "rclpy.lifecycle": dict(LifecycleNode=Node, LifecycleState=object, TransitionCallbackReturn=names),
        "rclpy.qos": dict(DurabilityPolicy=anything, QoSProfile=dict, ReliabilityPolicy=anything),
        "rosidl_runtime_py.utilities": dict(get_message=lambda kind: lambda **values: message(kind, **values)),
    }  # fmt: skip
    for name, values in kept.items():
        module = ModuleType(name)
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "ros2" / "voodoo_jax_ros"))
    from voodoo_jax_ros.node import Track

    yield Track()
    for name in [name for name in sys.modules if name.startswith("voodoo_jax_ros")]:
        del sys.modules[name]


def test_a_node_tracks_what_it_hears(node, tmp_path):
    with open(small_log(tmp_path / "arm.mcap", FRAMES), "rb") as file:
        heard = list(make_reader(file).iter_messages())
    node.values |= {
        "topics": [""], "body": "arm", "out": str(tmp_path / "out"), "start.scale": 0.8, "start.headings": 3,
        "start.frames": 2, "detect.points": 256, "track.chunk": 4, "track.skip": ["looks_ahead"],
    }  # fmt: skip
    assert node.on_configure(None) == "SUCCESS", node.said
    expected = replace(SETTINGS, track=replace(SETTINGS.track, chunk=4))
    assert (node._job.settings.start, node._job.settings.detect.points) == (expected.start, 256)
    assert node._job.settings.online and node._job.settings.track.chunk == 4
    assert node.on_activate(None) == "SUCCESS"
    node.topics = [(topic, [kind]) for topic, kind in {(c.topic, s.name) for s, c, _ in heard}]
    node.topics += [("/rosout", ["rcl_interfaces/msg/Log"]), ("/odd", ["somebody/msg/Thing"])]
    node._look()
    assert set(node.heard) == {c.topic for _, c, _ in heard}
    for _, channel, said in heard:
        node.now = said.log_time
        node.heard[channel.topic](said.data)
    # what the node itself gives out is not heard again
    wait_for(lambda: node.published["/tf"] or node._session.problem)
    own = STORE.serialize_cdr(node.published["/tf"][0], "tf2_msgs/msg/TFMessage")
    before = node._source._come.qsize()
    node._source.receive("/tf", "tf2_msgs/msg/TFMessage", own, 0)
    assert node._source._come.qsize() == before
    assert node.on_deactivate(None) == "SUCCESS" and not node._session.problem and not node.heard
    tracks = read_tracks_npz(tmp_path / "out" / "ros.tracks.npz")
    given = node.published["/tf"]
    assert len(given) == len(tracks.time_ns) == FRAMES and tracks.tracked.mean() > 0.9
    for i, one in enumerate(given):
        places = {t.child_frame_id: t.transform for t in one.transforms}
        stamp = one.transforms[0].header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == tracks.time_ns[i]
        at = places["voodoo/joint/elbow"].translation
        np.testing.assert_allclose([at.x, at.y, at.z], tracks.joint("elbow")[i], atol=1e-6)
        turn = places["voodoo/lower"].rotation
        np.testing.assert_allclose([turn.w, turn.x, turn.y, turn.z], tracks.rotation[i, 2], atol=1e-6)
    limb = node.published["~/body"][-1].markers[1]
    axis = tracks.joints[-1, 1] - tracks.joints[-1, 0]  # of the upper limb, from shoulder to elbow
    middle = np.array([limb.pose.position.x, limb.pose.position.y, limb.pose.position.z])
    assert np.linalg.norm(middle - (tracks.joints[-1, 0] + axis / 2)) < 0.08 and limb.header.frame_id == "base"
    status = node.published["/diagnostics"][-1].status[0]
    assert status.message == "tracked" and {pair.key for pair in status.values} >= {"residual_m", "confidence"}


def test_what_a_node_cannot_take_is_said(node):
    node.values |= {"detect.points": -5}
    assert node.on_configure(None) == "FAILURE" and "detect.points" in node.said[-1]
    from voodoo_jax_ros.bridge import parameters, settings_of

    assert settings_of({}) == settings_of(parameters(Settings()))
