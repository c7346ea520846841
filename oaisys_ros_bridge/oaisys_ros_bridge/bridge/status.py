"""Topics ``~/ready`` and ``/diagnostics``: the state of the bridge."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from std_msgs.msg import Bool

from oaisys_core.types import SimulatorInfo
from oaisys_ros_bridge.bridge.render_queue import RenderQueue
from oaisys_ros_bridge.bridge.simulator_link import SimulatorLink
from oaisys_ros_bridge.nodes.managed_node import ACTIVE, ManagedNode
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.qos import LATCHED_QOS

BYTES_PER_MB = 1e6

FIRST_BATCH_ERROR = "first_batch_error"
"""Key of why there is no world although the bridge tried twice; empty: there is one."""

FIRST_BATCH_RETRIED = "first_batch_retried_after"
"""Key of why the first of these tries failed; stays where the second one succeeds."""

SUBSCRIBERS = "subscribers "
"""Prefix of the keys that hold how many subscribers of a topic the bridge is matched with."""


class BridgeStatus:
    """Publishes whether a view can be requested, and diagnostics of simulator and readers.

    Args:
        node: The bridge.
        render_queue: Whose counts, link and readers are reported.
        settings: Returns the bridge's parameters.
        now: Returns the bridge's own time.
    """

    def __init__(
        self,
        node: ManagedNode,
        render_queue: RenderQueue,
        settings: Settings,
        now: Callable[[], Time],
    ) -> None:
        self._node = node
        self._render_queue = render_queue
        self._settings = settings
        self._now = now
        self._ready_lock = threading.Lock()
        self._is_ready: bool | None = None
        self._namesakes = 0
        self._ready = node.create_publisher(Bool, "~/ready", LATCHED_QOS)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def publish_ready(self) -> None:
        """Publish whether a view can be requested, if that has changed."""
        with self._ready_lock:
            link = self._render_queue.link
            ready = link is not None and link.state.ready and self._node.state == ACTIVE
            if ready != self._is_ready:
                self._is_ready = ready
                self._ready.publish(Bool(data=ready))

    def publish_diagnostics(self, reason: str | None = None) -> None:
        """Publish the status of the simulator and that of the readers.

        Args:
            reason: Why the simulator is not ready; None: the current reason.
        """
        address = self._settings()["address"]
        simulator = self._simulator_status(address, reason)
        array = DiagnosticArray(status=[simulator, self._readers_status(address)])
        array.header.stamp = self._now()
        self._diagnostics.publish(array)

    def _simulator_status(self, address: str, reason: str | None) -> DiagnosticStatus:
        link, state_name = self._render_queue.link, self._node.state_name
        if reason is None:
            reason = "" if link is None else link.state.reason
        level, message = DiagnosticStatus.WARN, state_name
        if self._node.aim == ACTIVE:
            level, message = DiagnosticStatus.ERROR, reason or state_name
        if self._is_ready:
            level, message = DiagnosticStatus.OK, "ready"
        if namesakes := self._count_namesakes():
            level = max(level, DiagnosticStatus.WARN)
            message += f"; {namesakes} other nodes have the name {own_name(self._node)}"
        values = {
            "address": address,
            "lifecycle_state": state_name,
            "nodes_of_this_name": 1 + namesakes,
            **_link_values(link),
            **self._renderer_values(),
            "memory_mb": resident_mb(),
            **_simulator_values(None if link is None else link.state.info),
        }
        for publisher in self._node.publishers:
            # A caller that must not lose the first sample waits until its subscribers are known.
            values[f"{SUBSCRIBERS}{publisher.topic_name}"] = publisher.get_subscription_count()
        name = f"{own_name(self._node)}: simulator"
        return _status(name, address, level, message, values)

    def _count_namesakes(self) -> int:
        """Return how many other nodes have this one's name; requests may reach any of them."""
        name = own_name(self._node)
        nodes = self._node.get_node_names_and_namespaces()
        found = max(0, sum(f"{space.rstrip('/')}/{each}" == name for each, space in nodes) - 1)
        if found > self._namesakes:
            self._node.get_logger().warning(
                f"{found} other nodes have the name {name}: requests may reach any of them. "
                "End them, or give each a namespace of its own (-r __ns:=/mars)"
            )
        self._namesakes = found
        return found

    def _renderer_values(self) -> dict[str, object]:
        counts = self._render_queue.counts
        return {
            "renderer": self._render_queue.activity,
            "queue": self._render_queue.waiting + counts.waiting_commands,
            "rendered": counts.rendered,
            "failed": counts.failed,
            "last_failure": counts.last_failure,
            "dropped_commands": counts.dropped_commands,
            "last_stamp_ns": counts.last_stamp_ns,
            "last_render_s": counts.last_render_s,
            "last_transfer_s": counts.last_transfer_s,
            "last_publish_s": counts.last_publish_s,
        }

    def _readers_status(self, address: str) -> DiagnosticStatus:
        """Return how far the mapper and recorders are."""
        wrong, values = self._render_queue.back_pressure.diagnostics()
        level = DiagnosticStatus.WARN if wrong else DiagnosticStatus.OK
        message = "; ".join(wrong) or "nothing is lost"
        return _status(f"{own_name(self._node)}: readers", address, level, message, values)


def own_name(node: Node) -> str:
    """Return the full name of a node."""
    return str(node.get_fully_qualified_name())


def _link_values(link: SimulatorLink | None) -> dict[str, object]:
    return {
        FIRST_BATCH_ERROR: "" if link is None else link.first_batch_error,
        FIRST_BATCH_RETRIED: "" if link is None else link.first_batch_retried_after,
        "connections": 0 if link is None else link.state.connections,
    }


def _simulator_values(info: SimulatorInfo | None) -> dict[str, object]:
    if info is None:
        return {"connected": False}
    return {
        "connected": True,
        "backend": f"{info.backend} {info.backend_version}",
        "device": info.device,
        "batch_id": info.batch_id,
        "worker_restarts": info.worker_restarts,
        **{f"placed {c.name}": f"{c.placed} of {c.asked}" for c in info.group_counts},
    }


def _status(
    name: str, hardware_id: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    entries = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    return DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=hardware_id, values=entries
    )


def resident_mb() -> float:
    """Return the resident memory of this process in MB; 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGESIZE") / BYTES_PER_MB


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.4f}" if isinstance(value, float) else str(value)
