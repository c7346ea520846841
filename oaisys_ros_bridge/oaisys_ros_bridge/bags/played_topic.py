"""A topic of a bag that is played: its publisher, and counts of what subscribers received."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from oaisys_ros_bridge.bags.message_definition import message_class
from oaisys_ros_bridge.bags.reading import offered_qos
from oaisys_ros_bridge.bags.writing import RecordedTopic

USUAL_DEPTH = 10
"""Depth of a queue, where the bag does not say."""


class PlayedTopic:
    """Publishes a topic's messages with the recorded quality of service, and counts its readers.

    On a reliable topic, no more messages are published than the queue holds until the readers have
    acknowledged them: a message that leaves the queue earlier could be lost. After a reader has
    failed to acknowledge in time, the topic does not wait any more.

    Args:
        node: Owner of the publisher.
        topic: As it was recorded.
        acknowledged_within_s: How long readers may take to acknowledge.

    Attributes:
        name: Of the topic as it is published, remapping included.
        sent: Messages published.
        with_reader: Those of them for which there was a reader.

    Raises:
        NotFoundError: The message's type is not installed.
    """

    def __init__(self, node: Node, topic: RecordedTopic, acknowledged_within_s: float) -> None:
        kind = message_class(topic.type_name)
        offered = offered_qos(topic.qos_profiles)
        self._depth = offered.depth or USUAL_DEPTH
        self._reliable, self._latched = offered.reliable, offered.transient_local
        reliable, latched = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
        profile = QoSProfile(
            depth=self._depth,
            reliability=reliable if self._reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=latched if self._latched else DurabilityPolicy.VOLATILE,
        )
        self._publisher: Publisher = node.create_publisher(kind, topic.name, profile)
        self._acknowledged_within_s = acknowledged_within_s
        self._outstanding = 0
        self._stalled = False
        self._most_readers = 0
        self.name: str = self._publisher.topic_name
        self.sent = 0
        self.with_reader = 0

    @property
    def readers(self) -> int:
        """Number of subscribers that are matched now."""
        return int(self._publisher.get_subscription_count())

    def publish(self, data: bytes) -> None:
        """Publish a serialised message (CDR with its header)."""
        if self._outstanding >= self._depth:
            self.wait_until_acknowledged(self._acknowledged_within_s)
        readers = self.readers
        self._publisher.publish(data)
        self.sent += 1
        self.with_reader += readers > 0
        self._outstanding += readers > 0 and self._reliable
        self._most_readers = max(self._most_readers, readers)

    def wait_until_acknowledged(self, timeout_s: float) -> None:
        """Wait for the readers' acknowledgements, unless one of them has been missing before."""
        if self._outstanding and not self._stalled:
            self._stalled = not self._publisher.wait_for_all_acked(Duration(seconds=timeout_s))
            self._outstanding = 0

    def finish(self, timeout_s: float) -> str:
        """Wait for the last acknowledgements; return the topic's counts in words."""
        self.wait_until_acknowledged(timeout_s)
        self._most_readers = max(self._most_readers, self.readers)
        if self._latched and self._most_readers:
            self.with_reader = max(self.with_reader, min(self.sent, self._depth))
        return f"{self.name}: {_count(self.sent, 'message')}, {self._audience()}"

    def _audience(self) -> str:
        if not self._most_readers:
            return "no reader"
        parts = [_count(self._most_readers, "reader")]
        if self.with_reader < self.sent:
            parts.append(f"but none for {self.sent - self.with_reader} of them")
        if not self._reliable:
            parts.append("best effort, which acknowledges nothing")
        else:
            parts.append("not acknowledged in time" if self._stalled else "acknowledged")
        return ", ".join(parts)


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
