"""Publishers by topic: those of a node, created on first use and destroyed together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from typing import Any, Protocol

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

IMAGE_COLOR = "image_color"
"""Last part of the names of topics on which labels and ids are colours."""


class TopicPublisher(Protocol):
    """What the topics need of a publisher, as rclpy's has it."""

    @property
    def topic_name(self) -> str:
        """Full name of the topic."""

    def publish(self, msg: Any) -> None:
        """Publish a message."""

    def get_subscription_count(self) -> int:
        """Return how many read the topic."""


class Publishers(ABC):
    """The publishers of all topics, wherever their messages go.

    Attributes:
        used: Full names of the topics on which `send` has published; cleared by the caller.
        counts: How many messages `send` has published, by the topic's full name.
    """

    def __init__(self) -> None:
        self.used: set[str] = set()
        self.counts: Counter[str] = Counter()

    def send(self, publisher: TopicPublisher, message: Any) -> None:
        """Publish a message of a sample, and add its topic to `used`."""
        publisher.publish(message)
        self.used.add(str(publisher.topic_name))
        self.counts[str(publisher.topic_name)] += 1

    @abstractmethod
    def offer(self, kind: type[Any], topic: str, qos: QoSProfile) -> TopicPublisher:
        """Return the publisher of a topic; create it if there is none."""


class NodePublishers(Publishers):
    """Publishers of one node.

    Args:
        node: Their owner.
    """

    def __init__(self, node: Node) -> None:
        super().__init__()
        self._node = node
        self._by_topic: dict[str, Publisher] = {}

    def offer(self, kind: type[Any], topic: str, qos: QoSProfile) -> Publisher:
        """Return the publisher of a topic; create it if there is none."""
        if topic not in self._by_topic:
            self._by_topic[topic] = self._node.create_publisher(kind, topic, qos)
        return self._by_topic[topic]

    def destroy(self) -> None:
        """Destroy all of them."""
        for publisher in self._by_topic.values():
            self._node.destroy_publisher(publisher)
        self._by_topic.clear()


def has_subscribers(publisher: TopicPublisher) -> bool:
    """Return whether the topic has subscribers: without any, no message need be made."""
    return int(publisher.get_subscription_count()) > 0
