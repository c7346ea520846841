"""Follows what the bridge, the mapper and the recorder publish about their own state."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool

from oaisys_core.errors import RenderError
from oaisys_msgs.msg import MapStatus, SampleReceipt
from oaisys_ros_bridge.bridge.back_pressure import state_of
from oaisys_ros_bridge.bridge.status import FIRST_BATCH_ERROR, SUBSCRIBERS
from oaisys_ros_bridge.conversions import nanoseconds
from oaisys_ros_bridge.namespaces import DOMAIN_VARIABLE
from oaisys_ros_bridge.nodes.background_node import BackgroundNode
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, LATCHED_QOS
from oaisys_ros_bridge.subscribing.ledger_state import shortfall

DISCOVERY_TIMEOUT_S = 30.0
DIAGNOSTICS_DEPTH = 10


class StackStatus:
    """The state of bridge, mapper and recorder, as a node receives it.

    Args:
        client: The node that subscribes; it may not be started yet.
    """

    def __init__(self, client: BackgroundNode) -> None:
        self._client = client
        self._bridge_is_ready = False
        self._first_batch_errors: dict[str, str] = {}
        self._integration_s: dict[int, float] = {}
        self._map = MapStatus()
        self._receipts: dict[tuple[str, int], SampleReceipt] = {}
        self._subscribers: dict[str, int] = {}
        self._transfer_s: dict[int, float] = {}
        client.subscribe(Bool, "oaisys_bridge/ready", self._on_ready, LATCHED_QOS)
        client.subscribe(MapStatus, "oaisys_mapper/metrics", self._on_map_status, LATCHED_QOS)
        client.subscribe(
            SampleReceipt, "oaisys_bridge/receipts", self._on_receipt, LATCHED_HISTORY_QOS
        )
        client.subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, DIAGNOSTICS_DEPTH)

    def wait_for_bridge(
        self, timeout_s: float, check: Callable[[], None], address: str = ""
    ) -> None:
        """Wait until the bridge says that its simulator has built a world.

        Args:
            timeout_s: How long.
            check: Called while waiting; may raise to stop.
            address: Of the simulator whose errors are raised; empty: any.

        Raises:
            RenderError: The simulator could not build a world.
            DeadlineExceededError: It has none in time; or there are two bridges of that name.
        """

        def check_all() -> None:
            check()
            for simulator, error in self._first_batch_errors.items():
                if error and address in ("", simulator):
                    raise RenderError(error)

        self._client.wait(
            "the bridge to be ready",
            lambda: self._bridge_is_ready and self.bridges > 0,
            timeout_s,
            check_all,
        )
        self.require_one_bridge()

    @property
    def bridges(self) -> int:
        """How many bridges of that name have been discovered so far; discovery has no end."""
        return int(self._client.node.count_publishers("oaisys_bridge/ready"))

    def require_one_bridge(self) -> None:
        """Wait until no second bridge of that name is known: it would answer calls, too.

        Raises:
            DeadlineExceededError: A second one stays.
        """
        domain = os.environ.get(DOMAIN_VARIABLE, "0")
        self._client.wait(
            f"all bridges but ours to leave ROS domain {domain} (set another ROS_DOMAIN_ID)",
            lambda: self.bridges <= 1,  # none: ours has ended, which the next call reports
            DISCOVERY_TIMEOUT_S,
        )

    def wait_for_mapper(self) -> None:
        """Wait until the mapper's first metrics have been received.

        Raises:
            DeadlineExceededError: None came in time.
        """
        self._client.wait(
            "the mapper's metrics", lambda: bool(self._integration_s), DISCOVERY_TIMEOUT_S
        )

    def wait_for_subscribers(self) -> None:
        """Wait until the bridge is matched with every subscription that this node knows of.

        A sample published earlier would not reach all of them.

        Raises:
            DeadlineExceededError: It is not in time.
        """
        self._client.wait(
            "the bridge to know its subscribers", self._all_matched, DISCOVERY_TIMEOUT_S
        )

    def _all_matched(self) -> bool:
        count = self._client.node.count_subscribers
        return bool(self._subscribers) and all(
            matched >= count(topic) for topic, matched in self._subscribers.items()
        )

    def transfer_s(self, stamp_ns: int) -> float:
        """Return how long the bridge waited for a sample beside its rendering; 0: not known."""
        with self._client.changed:
            return self._transfer_s.get(stamp_ns, 0.0)

    def wait_for_map(self, frames: int, timeout_s: float) -> list[float]:
        """Wait until the map holds ``frames`` frames; return the seconds that fusing each took.

        Frames that the mapper has counted as lost are not waited for; see `shortfalls`. The time of
        a frame whose metrics were replaced by the next frame's before they arrived is 0.

        Raises:
            DeadlineExceededError: It does not in time.
        """
        self._client.wait(
            f"{frames} frames in the map",
            lambda: (
                max(self._integration_s, default=0) >= frames
                or self._map.frames_integrated + self._map.samples_incomplete >= frames
            ),
            timeout_s,
        )
        return [self._integration_s.get(frame, 0.0) for frame in range(1, frames + 1)]

    def shortfalls(self, stamp_ns: int, timeout_s: float) -> list[str]:
        """Wait until mapper and recorder have received a sample; return what they have lost.

        Args:
            stamp_ns: Of the last sample.
            timeout_s: A node that has not received it by then is among the sentences.
        """
        end_s = time.monotonic() + timeout_s
        changed = self._client.changed
        with changed:
            while (late := self._late(stamp_ns)) and (left_s := end_s - time.monotonic()) > 0:
                changed.wait(left_s)
            found = [
                f"{receipt.node}: after {timeout_s:g} s it had taken {receipt.samples} samples,"
                " but not the last one"
                for receipt in late
            ]
            for receipt in self._receipts.values():
                name = receipt.node
                if lost := shortfall(state_of(receipt)):
                    found.append(f"{name}: {lost}")
                if receipt.ended and nanoseconds(receipt.header.stamp) < stamp_ns:
                    found.append(f"{name} had ended before the last sample")
            return found

    def _late(self, stamp_ns: int) -> list[SampleReceipt]:
        """Return the last receipts of nodes that still run and have not received a sample."""
        return [
            receipt
            for receipt in self._receipts.values()
            if not receipt.ended and nanoseconds(receipt.header.stamp) < stamp_ns
        ]

    def _on_ready(self, message: Bool) -> None:
        self._bridge_is_ready = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        values = {value.key: value.value for status in message.status for value in status.values}
        for key, value in values.items():
            if key.startswith(SUBSCRIBERS):
                self._subscribers[key.removeprefix(SUBSCRIBERS)] = int(value)
        if FIRST_BATCH_ERROR in values:
            self._first_batch_errors[values["address"]] = values[FIRST_BATCH_ERROR]
        if "last_transfer_s" in values:
            stamp_ns = int(values["last_stamp_ns"])
            self._transfer_s[stamp_ns] = float(values["last_transfer_s"])

    def _on_map_status(self, message: MapStatus) -> None:
        self._map = message
        self._integration_s[message.frames_integrated] = message.integration_time

    def _on_receipt(self, message: SampleReceipt) -> None:
        self._receipts[message.node, message.instance] = message
