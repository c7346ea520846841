"""Counts the samples that a mapper or recorder has taken, and reports them to the bridge."""

from __future__ import annotations

import secrets
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Header, String

from oaisys_core.errors import DeadlineExceededError
from oaisys_core.types import POINTS
from oaisys_msgs.msg import Loss, SampleInfo, SampleReceipt, SensorPose
from oaisys_msgs.srv import GetNewestSample
from oaisys_ros_bridge.conversions import nanoseconds, stamp_from_nanoseconds
from oaisys_ros_bridge.namespaces import UNKNOWN_NODE
from oaisys_ros_bridge.nodes.background_node import result_of
from oaisys_ros_bridge.qos import LATCHED_QOS
from oaisys_ros_bridge.subscribing.ledger_state import LedgerState, SampleName
from oaisys_ros_bridge.subscribing.sample_ledger import LOST_AFTER_S, SampleLedger
from oaisys_ros_bridge.timers import steady_timer

SAMPLE_INFO, RECEIPTS, CONFIGURATION = "sample_info", "receipts", "configuration"
NEWEST_SAMPLE = "get_newest_sample"
EXPIRY_PERIOD_S = 0.5
"""Between two checks for messages that are overdue."""
ASK_AGAIN_S = 1.0
"""After which a bridge is asked again: it drops answers to clients that it does not know."""


class Heard(NamedTuple):
    """What a bridge says of the samples and worlds that it has announced.

    Attributes:
        doubt: Why samples may be missing that no count has; empty: none are.
        batch_begin_ns: From which stamp on samples show its newest world; 0: not known.
    """

    doubt: str = ""
    batch_begin_ns: int = 0


class SampleWatch:
    """A ledger of the samples that one bridge announces, and the receipts for it.

    Samples before the first announcement count as lost only where the reader was there before the
    bridge: where the first configuration that the bridge latches, which it does before its first
    sample, is younger than `begin`.

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
        self._node = node
        self._node_name = node.get_fully_qualified_name()
        self._info_topic = info_topic
        self._instance = secrets.randbits(64)
        self._begun_ns: int | None = None
        self._lost_by_middleware = lost_by_middleware
        self._on_settled = on_settled
        self._lock = threading.Lock()
        self._ended = False
        self._reported: Mapping[str, int] = {}
        self.ledger = SampleLedger(info_topic, self._note_settled)
        bridge = info_topic.rpartition("/")[0]
        self._publisher = node.create_publisher(SampleReceipt, f"{bridge}/{RECEIPTS}", LATCHED_QOS)
        self._newest = node.create_client(
            GetNewestSample,
            f"{bridge}/{NEWEST_SAMPLE}",
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        node.create_subscription(
            String,
            f"{bridge}/{CONFIGURATION}",
            self._on_configuration,
            LATCHED_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        steady_timer(node, EXPIRY_PERIOD_S, self._check)
        self._publish_receipt()

    @property
    def state(self) -> LedgerState:
        """The ledger's counts, and those of the middleware."""
        return replace(self.ledger.state, lost_by_middleware=dict(self._lost_by_middleware))

    def begin(self, begun_ns: int) -> None:
        """Note since when (system time) the reader takes everything."""
        self._begun_ns = begun_ns

    @property
    def reader_was_first(self) -> bool:
        """Whether the reader was there before the bridge."""
        return self.ledger.expects_from_first

    def hear_newest(self, timeout_s: float) -> Heard:
        """Wait for the announcement of the newest sample, by what the bridge says which that is.

        The middleware keeps no order between an answer of the bridge and what it published before.
        An announcement that does not come within `LOST_AFTER_S` is counted as lost. Not to be
        called by the executor's only thread.

        Args:
            timeout_s: Longest time to wait for what the bridge says.
        """
        if self._begun_ns is None or not self._is_published_by_bridge():
            return Heard()
        newest = self._ask_newest(timeout_s)
        if newest is None or not newest.success:
            reason = "no answer" if newest is None else newest.message
            return Heard(f"{self._newest.srv_name} did not say which sample is the last: {reason}")
        if newest.sequence and nanoseconds(newest.published) > self._begun_ns:
            name = SampleName(newest.batch_id, newest.sample_id, nanoseconds(newest.stamp))
            self.ledger.wait_for_announcement(name, newest.sequence, LOST_AFTER_S)
        return Heard(batch_begin_ns=nanoseconds(newest.batch_begin))

    def _ask_newest(self, timeout_s: float) -> GetNewestSample.Response | None:
        """Ask the bridge which sample is the newest; None: it does not answer in time."""
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0:
            if not self._newest.wait_for_service(min(ASK_AGAIN_S, left_s)):
                continue
            asked = self._newest.call_async(GetNewestSample.Request())
            with suppress(DeadlineExceededError):
                return result_of(asked, self._newest.srv_name, min(ASK_AGAIN_S, left_s))
            self._newest.remove_pending_request(asked)
        return None

    def end(self) -> None:
        """Tell the bridge that this reader takes no more samples."""
        self._publish_receipt(ended=True)

    def _on_configuration(self, _: String, info: dict[str, int]) -> None:
        """Expect all samples of a bridge that has begun after the reader."""
        is_first = info["publication_sequence_number"] == 1
        is_younger = self._begun_ns is not None and info["source_timestamp"] > self._begun_ns
        if is_first and is_younger and self._is_published_by_bridge():
            self.ledger.expect_from_first()

    def _is_published_by_bridge(self) -> bool:
        """Return whether a bridge announces the samples, rather than the player of a bag."""
        bridge = self._info_topic.rpartition("/")[0].rpartition("/")[2]
        publishers = self._node.get_publishers_info_by_topic(self._info_topic)
        return any(each.node_name in (bridge, UNKNOWN_NODE) for each in publishers)

    def _check(self) -> None:
        """Look for messages that are overdue, and for new losses of the middleware."""
        self.ledger.expire()
        if self._reported != self._lost_by_middleware:
            self._note_settled()

    def _note_settled(self) -> None:
        self._publish_receipt()
        self._on_settled()

    def _publish_receipt(self, *, ended: bool = False) -> None:
        with self._lock:  # an older state must not follow a newer one
            if self._ended:
                return
            self._ended = ended
            state = self.state
            self._reported = state.lost_by_middleware
            last = state.last or SampleName(0, 0, 0)
            self._publisher.publish(
                SampleReceipt(
                    header=Header(stamp=stamp_from_nanoseconds(last.stamp_ns)),
                    node=self._node_name,
                    instance=self._instance,
                    batch_id=last.batch_id,
                    sample_id=last.sample_id,
                    samples=state.settled,
                    samples_incomplete=state.incomplete,
                    lost=losses_msg(state.lost),
                    lost_by_middleware=losses_msg(state.lost_by_middleware),
                    ended=ended,
                )
            )


def losses_msg(lost: Mapping[str, int]) -> list[Loss]:
    """Return counts as messages, by name."""
    return [Loss(what=what, count=count) for what, count in sorted(lost.items())]


def camera_poses(info: SampleInfo) -> list[SensorPose]:
    """Return the cameras of an announced sample, without its lidars."""
    return [sensor for sensor in info.sensors if list(sensor.modalities) != [POINTS]]


def name_of(info: SampleInfo) -> SampleName:
    """Return which sample a message announces."""
    return SampleName(info.batch_id, info.sample_id, nanoseconds(info.header.stamp))


def counting_losses(
    lost: Counter[str], topic: str, qos: QoSProfile
) -> SubscriptionEventCallbacks | None:
    """Return callbacks that count the messages of a topic that the middleware says were lost.

    None for a latched topic, of which only the last messages count.
    """
    if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        return None

    def add(status: Any) -> None:
        lost[topic] += status.total_count_change

    return SubscriptionEventCallbacks(message_lost=add)
