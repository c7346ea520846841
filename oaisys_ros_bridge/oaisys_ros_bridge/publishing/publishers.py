"""The publishers of a node by topic, created on first use and destroyed together."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile


class Publishers:
    """Publishers of one node.

    Args:
        node: Their owner.

    Attributes:
        used: Full names of the topics on which `send` has published; cleared by the caller.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._by_topic: dict[str, Publisher] = {}
        self.used: set[str] = set()

    def send(self, publisher: Publisher, message: Any) -> None:
        """Publish a message of a sample, and add its topic to `used`."""
        publisher.publish(message)
        self.used.add(str(publisher.topic_name))

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


def has_subscribers(publisher: Publisher) -> bool:
    """Return whether the topic has subscribers: without any, no message need be made."""
    return int(publisher.get_subscription_count()) > 0
