"""A topic of a bag that is played: its publisher, and counts of what subscribers received."""

from __future__ import annotations

from collections import Counter, deque

from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rclpy.validate_full_topic_name import validate_full_topic_name

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.bags.mcap_format.message_definition import message_class
from oaisys_ros_bridge.bags.reading import topic_qos
from oaisys_ros_bridge.bags.writing import RecordedTopic
from oaisys_ros_bridge.namespaces import UNKNOWN_NODE

USUAL_DEPTH = 10
"""Depth of a queue, where the bag does not say."""


class PlayedTopic:
    """Publishes a topic's messages with the recorded quality of service, and counts its readers.

    On a reliable topic, no more messages are published than the queue holds until the readers have
    acknowledged them: a message that leaves the queue earlier could be lost. After a reader has
    failed to acknowledge in time, the topic does not wait any more. A latched topic sends late
    readers the messages that are still in its queue.

    Args:
        node: Owner of the publisher.
        topic: As it was recorded.
        acknowledged_within_s: How long readers may take to acknowledge.

    Attributes:
        name: Of the topic as it is published, remapping included.
        sent: Messages published.

    Raises:
        InvalidInputError: ROS cannot use the topic's name.
        NotFoundError: The message's type is not installed.
    """

    def __init__(self, node: Node, topic: RecordedTopic, acknowledged_within_s: float) -> None:
        _check_name(topic.name, node)
        kind = message_class(topic.type_name)
        offered = topic_qos(topic.qos_profiles)
        self._node = node
        self._depth = offered.depth or USUAL_DEPTH
        self._reliable = offered.reliable
        reliable, latched = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
        profile = QoSProfile(
            depth=self._depth,
            reliability=reliable if self._reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=latched if offered.transient_local else DurabilityPolicy.VOLATILE,
        )
        self._publisher: Publisher = node.create_publisher(kind, topic.name, profile)
        self._acknowledged_within_s = acknowledged_within_s
        self._outstanding = 0
        self._stalled = False
        self._readers = self._most_readers = self._most_best_effort = 0
        self._sent_to: Counter[int] = Counter()
        self._latched: deque[int] = deque(maxlen=self._depth if offered.transient_local else 0)
        self.name: str = self._publisher.topic_name
        self.sent = 0

    @property
    def readers(self) -> int:
        """Number of subscribers that are matched now."""
        return int(self._publisher.get_subscription_count())

    @property
    def with_reader(self) -> int:
        """Number of messages published for which there was a reader."""
        return self.sent - self._sent_to[0] - self._latched.count(0)

    @property
    def reading_nodes(self) -> set[tuple[str, str, bytes]]:
        """Nodes with a subscription that can be matched: namespace, name, and its process' id."""
        return {
            # The first 12 bytes of an endpoint's id are its participant's.
            (each.node_namespace, each.node_name, bytes(each.endpoint_gid[:12]))
            for each in self._subscriptions()
            if each.node_name != UNKNOWN_NODE
        }

    @property
    def is_matched(self) -> bool:
        """Whether all subscriptions that are known, and can be matched, are matched."""
        return self.readers >= len(self._subscriptions())

    def publish(self, data: bytes) -> None:
        """Publish a serialised message (CDR with its header)."""
        if self._outstanding >= self._depth:
            self.wait_until_acknowledged(self._acknowledged_within_s)
        self._count_readers()
        self._publisher.publish(data)
        self.sent += 1
        if self._latched.maxlen:
            if len(self._latched) == self._latched.maxlen:
                self._sent_to[self._latched.popleft()] += 1
            self._latched.append(self._readers)
        else:
            self._sent_to[self._readers] += 1
        self._outstanding += self._readers > 0 and self._reliable

    def wait_until_acknowledged(self, timeout_s: float) -> None:
        """Wait for the readers' acknowledgements, unless one of them has been missing before."""
        if self._outstanding and not self._stalled:
            self._stalled = not self._publisher.wait_for_all_acked(Duration(seconds=timeout_s))
            self._outstanding = 0

    def finish(self, timeout_s: float) -> str:
        """Wait for the last acknowledgements; return the topic's counts in words."""
        self.wait_until_acknowledged(timeout_s)
        self._count_readers()
        return f"{self.name}: {_count(self.sent, 'message')}, {self._audience()}"

    def _count_readers(self) -> None:
        """Note how many readers there are, and which messages of the queue the new ones get."""
        readers = self.readers
        if readers == self._readers:
            return
        self._readers = readers
        self._most_readers = max(self._most_readers, readers)
        best_effort = ReliabilityPolicy.BEST_EFFORT
        found = sum(s.qos_profile.reliability == best_effort for s in self._subscriptions())
        self._most_best_effort = max(self._most_best_effort, min(found, readers))
        for index, sent_to in enumerate(self._latched):
            self._latched[index] = max(sent_to, readers)

    def _subscriptions(self) -> list[TopicEndpointInfo]:
        """Return the known subscriptions that ask for no more than the publisher offers."""
        found = self._node.get_subscriptions_info_by_topic(self.name)
        return [each for each in found if self._fits(each.qos_profile)]

    def _fits(self, asked: QoSProfile) -> bool:
        # rclpy's check takes an infinite deadline, as it is discovered, for one that is too short.
        if asked.reliability == ReliabilityPolicy.RELIABLE and not self._reliable:
            return False
        return bool(self._latched.maxlen) or asked.durability != DurabilityPolicy.TRANSIENT_LOCAL

    def _audience(self) -> str:
        most = self._most_readers
        if not most:
            return "no reader"
        parts = [_count(most, "reader")]
        fewer = [
            f"{_count(messages, 'message')} to {f'only {readers}' if readers else 'none'}"
            for readers, messages in sorted((self._sent_to + Counter(self._latched)).items())
            if readers < most
        ]
        if fewer:
            parts.append(f"but {' and '.join(fewer)}")
        return ", ".join([*parts, self._acknowledgement()])

    def _acknowledgement(self) -> str:
        if not self._reliable or self._most_best_effort == self._most_readers:
            return "best effort, which acknowledges nothing"
        if self._stalled:
            return "not acknowledged in time"
        if self._most_best_effort:
            reliable = self._most_readers - self._most_best_effort
            return f"acknowledged by {reliable}, best effort to {self._most_best_effort}"
        return "acknowledged"


def _check_name(name: str, node: Node) -> None:
    """Raise `InvalidInputError` where ROS cannot use the name of a topic of a bag."""
    try:
        full = expand_topic_name(name, node.get_name(), node.get_namespace())
        validate_full_topic_name(full)
    except (NameValidationException, ValueError) as error:
        expected = "the name of a topic that ROS can use, of letters, digits, '_' and '/'"
        raise InvalidInputError("bag", name, expected) from error


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
