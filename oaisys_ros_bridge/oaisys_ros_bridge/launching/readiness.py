"""The bridge's ready signal as an event of the launch system, for launch files to wait on.

A launch file that includes ``simulator.launch.py`` starts a planner once there is a world to see::

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
    """A bridge has a world to show.

    Attributes:
        namespace: The bridge's; empty: the root.
    """

    name = "oaisys_ros_bridge.Ready"

    def __init__(self, namespace: str) -> None:
        """Tell of a bridge."""
        self.namespace = namespace


class WatchReadiness(Action):
    """Listens to a bridge's latched ``~/ready`` and emits `Ready`, once."""

    def __init__(self, namespace: str) -> None:
        """Watch the bridge of a namespace."""
        super().__init__()
        self._namespace = namespace.strip("/")
        self._subscription: Subscription | None = None

    def execute(self, context: LaunchContext) -> None:
        """Begin to listen."""
        prefix = f"/{self._namespace}" if self._namespace else ""
        topic = f"{prefix}/oaisys_bridge/ready"
        told = False

        def take(message: Bool) -> None:
            nonlocal told
            if message.data and not told:
                told = True
                event = Ready(self._namespace)
                context.asyncio_loop.call_soon_threadsafe(context.emit_event_sync, event)

        node = get_ros_node(context)
        self._subscription = node.create_subscription(Bool, topic, take, LATCHED_QOS)


def on_ready(actions: Sequence[Action], namespace: str = "") -> RegisterEventHandler:
    """Return what runs actions once the bridge of a namespace is ready."""
    wanted = namespace.strip("/")
    handler = EventHandler(
        matcher=lambda event: isinstance(event, Ready) and event.namespace == wanted,
        entities=list(actions),
        handle_once=True,
    )
    return RegisterEventHandler(handler)
