"""Counts the samples that a mapper or recorder has taken, and reports them to the bridge."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from std_msgs.msg import Header

from oaisys_msgs.msg import Loss, SampleInfo, SampleReceipt
from oaisys_ros_bridge.conversions import nanoseconds, stamp_from_nanoseconds
from oaisys_ros_bridge.qos import LATCHED_QOS
from oaisys_ros_bridge.subscribing.sample_ledger import SampleLedger, SampleName
from oaisys_ros_bridge.timers import steady_timer

SAMPLE_INFO, RECEIPTS = "sample_info", "receipts"
EXPIRY_PERIOD_S = 0.5
"""Between two checks for messages that are overdue."""


class SampleWatch:
    """A ledger of the samples that one bridge announces, and the receipts for it.

    Args:
        node: The reader.
        info_topic: Full name of the topic on which samples are announced.
        lost_by_middleware: Messages that the middleware reports as lost, by topic.
        on_settled: Called after the ledger has closed samples.
    """

    def __init__(
        self,
        node: Node,
        info_topic: str,
        lost_by_middleware: Mapping[str, int],
        on_settled: Callable[[], object] = lambda: None,
    ) -> None:
        self._node_name = node.get_fully_qualified_name()
        self._lost_by_middleware = lost_by_middleware
        self._on_settled = on_settled
        self._lock = threading.Lock()
        self._ended = False
        self.ledger = SampleLedger(info_topic, self._settled)
        topic = f"{info_topic.rpartition('/')[0]}/{RECEIPTS}"
        self._publisher = node.create_publisher(SampleReceipt, topic, LATCHED_QOS)
        steady_timer(node, EXPIRY_PERIOD_S, self.ledger.expire)
        self._publish_receipt()

    def end(self) -> None:
        """Tell the bridge that this reader takes no more samples."""
        self._publish_receipt(ended=True)

    def _settled(self) -> None:
        self._publish_receipt()
        self._on_settled()

    def _publish_receipt(self, *, ended: bool = False) -> None:
        with self._lock:  # an older state must not follow a newer one
            if self._ended:
                return
            self._ended = ended
            state = self.ledger.state
            last = state.last or SampleName(0, 0, 0)
            self._publisher.publish(
                SampleReceipt(
                    header=Header(stamp=stamp_from_nanoseconds(last.stamp_ns)),
                    node=self._node_name,
                    batch_id=last.batch_id,
                    sample_id=last.sample_id,
                    samples=state.settled,
                    samples_incomplete=state.incomplete,
                    lost=losses_msg(state.lost),
                    lost_by_middleware=losses_msg(self._lost_by_middleware),
                    ended=ended,
                )
            )


def losses_msg(lost: Mapping[str, int]) -> list[Loss]:
    """Return counts as messages, by name."""
    return [Loss(what=what, count=count) for what, count in sorted(lost.items())]


def name_of(info: SampleInfo) -> SampleName:
    """Return which sample a message announces."""
    return SampleName(info.batch_id, info.sample_id, nanoseconds(info.header.stamp))


def counting_losses(lost: Counter[str], topic: str) -> SubscriptionEventCallbacks:
    """Return callbacks that count the messages of a topic that the middleware reports as lost."""

    def add(status: Any) -> None:
        lost[topic] += status.total_count_change

    return SubscriptionEventCallbacks(message_lost=add)
