"""Emits a launch event when a bridge is ready, so that launch files can wait for it.

A launch file that includes ``simulator.launch.py`` starts a planner once there is a world::

    from oaisys_ros_bridge.launching.readiness import on_ready

    LaunchDescription([IncludeLaunchDescription(...), on_ready([Node(package="my_planner", ...)])])
"""

from __future__ import annotations

from collections.abc import Sequence

from launch.action import Action
from launch.actions import RegisterEventHandler
from launch_ros.ros_adapters import get_ros_node
from rclpy.subscription import Subscription
from std_msgs.msg import Bool

from launch import Event, EventHandler, LaunchContext
from oaisys_ros_bridge.qos import LATCHED_QOS


class Ready(Event):
    """A bridge's simulator has built a world.

    Attributes:
        namespace: The bridge's; empty: the root.
    """

    name = "oaisys_ros_bridge.Ready"

    def __init__(self, namespace: str) -> None:
        """Make the event of the bridge in a namespace."""
        self.namespace = namespace


class WatchReadiness(Action):
    """Subscribes to a bridge's latched ``~/ready`` and emits `Ready` once."""

    def __init__(self, namespace: str) -> None:
        """Watch the bridge of a namespace."""
        super().__init__()
        self._namespace = namespace.strip("/")
        self._subscription: Subscription | None = None

    def execute(self, context: LaunchContext) -> None:
        """Subscribe."""
        prefix = f"/{self._namespace}" if self._namespace else ""
        topic = f"{prefix}/oaisys_bridge/ready"
        has_emitted = False

        def on_message(message: Bool) -> None:
            nonlocal has_emitted
            if message.data and not has_emitted:
                has_emitted = True
                event = Ready(self._namespace)
                context.asyncio_loop.call_soon_threadsafe(context.emit_event_sync, event)

        node = get_ros_node(context)
        self._subscription = node.create_subscription(Bool, topic, on_message, LATCHED_QOS)


def on_ready(actions: Sequence[Action], namespace: str = "") -> RegisterEventHandler:
    """Return a handler that runs actions once the bridge in a namespace is ready."""
    wanted = namespace.strip("/")
    handler = EventHandler(
        matcher=lambda event: isinstance(event, Ready) and event.namespace == wanted,
        entities=list(actions),
        handle_once=True,
    )
    return RegisterEventHandler(handler)
