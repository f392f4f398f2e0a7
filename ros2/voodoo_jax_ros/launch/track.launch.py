"""Starts the node and brings it through its states: configured, then active."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import EmitEvent, RegisterEventHandler
from launch.events import matches_action
from launch_ros.actions import LifecycleNode
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition


def generate_launch_description() -> LaunchDescription:
    settings = os.path.join(get_package_share_directory("voodoo_jax_ros"), "config", "track.yaml")
    node = LifecycleNode(
        package="voodoo_jax_ros", executable="track", name="voodoo_jax", namespace="", parameters=[settings],
        output="screen",
    )  # fmt: skip

    def change(transition: int) -> EmitEvent:
        return EmitEvent(event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition))

    activate = OnStateTransition(
        target_lifecycle_node=node, goal_state="inactive", entities=[change(Transition.TRANSITION_ACTIVATE)]
    )
    return LaunchDescription([node, RegisterEventHandler(activate), change(Transition.TRANSITION_CONFIGURE)])
