"""Publishers whose messages go into a bag instead of to other nodes."""

from __future__ import annotations

from typing import Any

from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage

from oaisys_ros_bridge.bags.topic_selection import bag_profile
from oaisys_ros_bridge.bags.writing import BagWriter, RecordedTopic
from oaisys_ros_bridge.publishing.publishers import IMAGE_COLOR, Publishers

NOT_RECORDED = (CompressedImage,)
"""Types whose messages are not made, because the bag has the same images raw; nor are colours of
labels and ids."""


class BagPublishers(Publishers):
    """Writes what is published into a bag; no node and no middleware is needed.

    Args:
        bag: The bag.

    Attributes:
        time_ns: Time at which messages are written; set by the caller.
    """

    def __init__(self, bag: BagWriter) -> None:
        super().__init__()
        self._bag = bag
        self._by_topic: dict[str, BagPublisher] = {}
        self.time_ns = 0

    def offer(self, kind: type[Any], topic: str, qos: QoSProfile) -> BagPublisher:
        """Return the publisher of a topic; relative names are below the root."""
        name = f"/{topic.removeprefix('/')}"
        if name not in self._by_topic:
            self._by_topic[name] = BagPublisher(self, kind, name, qos)
        return self._by_topic[name]

    def write(self, topic: RecordedTopic, message: Any) -> None:
        """Write a message; the bag gets the topic with its first message."""
        self._bag.add_topic(topic)
        self._bag.write(topic.name, serialize_message(message), self.time_ns, self.time_ns)


class BagPublisher:
    """A topic of `BagPublishers`, with the methods of rclpy's publisher."""

    def __init__(self, owner: BagPublishers, kind: type[Any], topic: str, qos: QoSProfile) -> None:
        self._owner = owner
        self._is_recorded = kind not in NOT_RECORDED and not topic.endswith(f"/{IMAGE_COLOR}")
        type_name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        self._topic = RecordedTopic(topic, type_name, (bag_profile(qos),))

    @property
    def topic_name(self) -> str:
        """Full name of the topic."""
        return self._topic.name

    def publish(self, msg: Any) -> None:
        """Write a message."""
        self._owner.write(self._topic, msg)

    def get_subscription_count(self) -> int:
        """Return 1 if the topic is recorded, else 0."""
        return int(self._is_recorded)
