"""A lifecycle node: subscribes to depth images or clouds, and gives out transforms, markers and diagnostics.

Configured it has its settings and body; active it subscribes and tracks; deactivated it writes the results.
"""

from dataclasses import replace
from typing import Any

import rclpy
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosidl_runtime_py.utilities import get_message

from voodoo_jax.batch.live import LiveJob
from voodoo_jax.compile.cache_dir import safe_folder, use_compile_cache
from voodoo_jax.model.body_file import load_on_host
from voodoo_jax_ros.bridge import Given, Session, TopicSource, parameters, settings_of

OUT = {
    "tf": ("tf2_msgs/msg/TFMessage", "/tf"),
    "body": ("visualization_msgs/msg/MarkerArray", "~/body"),
    "diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "/diagnostics"),
}
LOOK = 1.0  # seconds between looks at which topics there are
WAITING = 50  # messages that wait of each topic


class Track(LifecycleNode):
    """voodoo_jax as a node."""

    def __init__(self) -> None:
        super().__init__("voodoo_jax")
        own = {"topics": [""], "body": "human", "names": "", "out": "voodoo-out"}
        self._defaults = own | parameters()
        for name, value in self._defaults.items():
            self.declare_parameter(name, value)
        self._session: Session | None = None
        self._heard: dict[str, Any] = {}

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._given = {name: self.get_parameter(name).value for name in self._defaults}
        try:
            use_compile_cache(safe_folder("", self._say))
            settings = settings_of(self._given)
            settings = replace(settings, detect=replace(settings.detect, people=1))
            body = load_on_host(self._given["body"])
            self._job = LiveJob("ros", self._given["out"], body, settings, self._given["names"])
        except (ValueError, OSError) as problem:
            self.get_logger().error(str(problem))
            return TransitionCallbackReturn.FAILURE
        self._out = {n: self.create_lifecycle_publisher(get_message(k), topic, 10) for n, (k, topic) in OUT.items()}
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._source = TopicSource()
        make = lambda kind, **values: get_message(kind)(**values)  # noqa: E731
        publish = lambda name, message: self._out[name].publish(message)  # noqa: E731
        self._session = Session(self._source, self._job, [Given(make, publish)], self._say)
        self._timer = self.create_timer(LOOK, self._look)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.destroy_timer(self._timer)
        for subscription in self._heard.values():
            self.destroy_subscription(subscription)
        self._heard = {}
        if self._session is not None:
            if not self._session.end():
                self._say("gave up waiting: the results are not written")
                return TransitionCallbackReturn.FAILURE
            if self._session.outcome is not None:
                self._say(str(self._session.outcome))
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        for publisher in self._out.values():
            self.destroy_publisher(publisher)
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self._session is not None:
            self._session.end()
        return TransitionCallbackReturn.SUCCESS

    def _look(self) -> None:
        """Subscribes to topics of use that are new."""
        asked = [name for name in self._given["topics"] if name]
        for topic, kinds in self.get_topic_names_and_types():
            wanted = topic in self._heard or (asked and topic not in asked and not topic.startswith("/tf"))
            if wanted or topic.startswith(f"/{self.get_name()}/") or not self._source.wants(topic, kinds[0]):
                continue
            static = topic.endswith("tf_static")
            quality = QoSProfile(
                depth=100 if static else WAITING,
                reliability=ReliabilityPolicy.RELIABLE if static else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if static else DurabilityPolicy.VOLATILE,
            )

            def take(data: bytes, topic: str = topic, kind: str = kinds[0]) -> None:
                self._source.receive(topic, kind, data, self.get_clock().now().nanoseconds)

            self._heard[topic] = self.create_subscription(get_message(kinds[0]), topic, take, quality, raw=True)

    def _say(self, text: object) -> None:
        self.get_logger().info(str(text))


def main() -> None:
    rclpy.init()
    node = Track()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        node.on_shutdown(None)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
