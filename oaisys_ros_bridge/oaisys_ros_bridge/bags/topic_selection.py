"""Decides which topics a recorder records, and with which quality of service it subscribes."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from oaisys_ros_bridge.bags.info import MOTION_TYPES, SAMPLE_INFO_TYPE, TF_TYPE
from oaisys_ros_bridge.bags.writing import RecordedTopic, qos_entry
from oaisys_ros_bridge.namespaces import OUTSIDE
from oaisys_ros_bridge.qos import MOTION_QOS, SMALL_MESSAGE_QOS

RECEIPT_TYPE = "oaisys_msgs/msg/SampleReceipt"

QUEUE_DEPTH = 50
"""Messages of a topic that may be queued; the bridge waits long before there are so many."""

QUEUE_DEPTHS = {
    SAMPLE_INFO_TYPE: SMALL_MESSAGE_QOS.depth,
    **dict.fromkeys((TF_TYPE, *MOTION_TYPES), MOTION_QOS.depth),
}
"""Of small messages, by their type; transforms come from other nodes, too, and are repeated."""


@dataclass(frozen=True)
class TopicSelection:
    """Which topics are recorded.

    Attributes:
        requested: Full names that were given.
        everything: Whether all other topics are recorded, too: those in ``namespace`` and the
            ``shared`` ones that are not hidden and not excluded.
        exclude: Expression that matches the whole name of an excluded topic.
        namespace: Of the recorder.
        shared: Full names of topics that belong to the namespace wherever they are, such as
            ``/tf``, as the recorder's remapping rules have them.
    """

    requested: Collection[str]
    everything: bool
    exclude: re.Pattern[str]
    namespace: str
    shared: Collection[str]

    @classmethod
    def of(cls, node: Node, values: Mapping[str, Any]) -> Self:
        """Return the selection of a recorder beside a node, from the values of its parameters."""
        requested = {node.resolve_topic_name(name) for name in values["topics"] if name}
        everything = values["all"] or not requested
        shared = {node.resolve_topic_name(name) for name in OUTSIDE}
        exclude = re.compile(values["exclude"])
        return cls(requested, everything, exclude, node.get_namespace(), shared)

    def includes(self, name: str, type_name: str = "") -> bool:
        """Return whether a topic is recorded."""
        if name in self.requested or not self.everything:
            return name in self.requested
        if type_name == RECEIPT_TYPE:
            return False  # when the bag is played, a bridge would wait for a node that is not there
        is_hidden = any(part.startswith("_") for part in name.split("/"))
        return not is_hidden and self.is_near(name) and not self.exclude.fullmatch(name)

    def is_near(self, name: str) -> bool:
        """Return whether a topic belongs to the recorder's namespace."""
        return name in self.shared or name.startswith(f"{self.namespace.rstrip('/')}/")


def describe_topic(
    name: str, type_name: str, publishers: Sequence[TopicEndpointInfo]
) -> RecordedTopic:
    """Return the description of a topic in a bag, with what its publishers offer."""
    return RecordedTopic(name, type_name, tuple(bag_profile(p.qos_profile) for p in publishers))


def subscription_qos(type_name: str, publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Return the quality of service of a subscription that is compatible with all publishers."""
    reliable = all(_is_reliable(publisher.qos_profile) for publisher in publishers)
    latched = all(_is_latched(publisher.qos_profile) for publisher in publishers)
    return QoSProfile(
        depth=QUEUE_DEPTHS.get(type_name, QUEUE_DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def bag_profile(profile: QoSProfile) -> dict[str, Any]:
    """Return a quality of service as a bag stores it."""
    return qos_entry(
        depth=profile.depth,
        reliable=_is_reliable(profile),
        transient_local=_is_latched(profile),
    )


def _is_reliable(profile: QoSProfile) -> bool:
    return bool(profile.reliability == ReliabilityPolicy.RELIABLE)


def _is_latched(profile: QoSProfile) -> bool:
    return bool(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)
