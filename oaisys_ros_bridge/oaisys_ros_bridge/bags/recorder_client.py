"""Waits until the recorder hears all that a bridge publishes and the recorder is to record."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Bool

from oaisys_core.errors import DeadlineExceededError
from oaisys_ros_bridge.bags.topic_selection import TopicSelection
from oaisys_ros_bridge.bridge.status import SUBSCRIBERS
from oaisys_ros_bridge.nodes.background_node import BackgroundNode, result_of
from oaisys_ros_bridge.qos import LATCHED_QOS

RECORDER, RECORDING = "oaisys_recorder", "oaisys_recorder/recording"
DIAGNOSTICS_DEPTH = 10

ANSWER_S = 2.0
"""After which the recorder is asked again: it drops answers to clients that it does not know."""


class RecorderClient:
    """What a node knows of the recorder in its namespace.

    Args:
        client: The node; it may not be started yet.
    """

    def __init__(self, client: BackgroundNode) -> None:
        self._client = client
        self._is_recording = False
        self._matched: dict[str, int] = {}
        self._parameters = AsyncParameterClient(client.node, RECORDER)
        client.subscribe(Bool, RECORDING, self._on_recording, LATCHED_QOS)
        client.subscribe(DiagnosticArray, "/diagnostics", self._on_diagnostics, DIAGNOSTICS_DEPTH)

    def wait(self, timeout_s: float) -> None:
        """Wait until the recorder is subscribed to the topics of a bridge that is ready.

        A recorder that runs before the bridge says that it records when the bridge's topics, of
        which it cannot know, do not exist yet.

        Raises:
            DeadlineExceededError: It is not in time.
        """
        self._client.wait(RECORDING, lambda: self._is_recording, timeout_s)
        selection = self._selection(timeout_s)
        self._client.wait(
            "the recorder to be known to the bridge on all its topics",
            lambda: bool(self._matched) and all(map(self._is_heard, self._choose(selection))),
            timeout_s,
        )

    def _selection(self, timeout_s: float) -> TopicSelection:
        """Ask the recorder what it records."""
        names = ["topics", "all", "exclude"]
        self._client.wait("the recorder", self._parameters.services_are_ready, timeout_s)
        for _ in range(max(1, int(timeout_s / ANSWER_S))):
            asked: Future = self._parameters.get_parameters(names)
            try:
                answer: Any = result_of(asked, RECORDER, ANSWER_S)
            except DeadlineExceededError:
                continue
            values = dict(zip(names, map(parameter_value_to_python, answer.values), strict=True))
            return TopicSelection.of(self._client.node, values)
        raise DeadlineExceededError(f"{RECORDER} did not answer within {timeout_s:g} s")

    def _choose(self, selection: TopicSelection) -> list[str]:
        return [topic for topic in self._matched if selection.includes(topic)]

    def _is_heard(self, topic: str) -> bool:
        """Return whether the recorder is a subscriber, and the bridge knows all subscribers."""
        node = self._client.node
        publishers = node.get_publishers_info_by_topic(topic)
        subscribers = [
            each
            for each in node.get_subscriptions_info_by_topic(topic)
            if all(_fit(publisher, each) for publisher in publishers)
        ]
        names = {(each.node_name, each.node_namespace) for each in subscribers}
        is_there = (RECORDER, node.get_namespace()) in names
        return is_there and self._matched[topic] >= len(subscribers)

    def _on_recording(self, message: Bool) -> None:
        self._is_recording = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for value in (each for status in message.status for each in status.values):
            if value.key.startswith(SUBSCRIBERS):
                self._matched[value.key.removeprefix(SUBSCRIBERS)] = int(value.value)


def _fit(publisher: TopicEndpointInfo, subscriber: TopicEndpointInfo) -> bool:
    """Return whether their qualities of service let a publisher know a subscriber."""
    compatibility, _ = qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)
    return bool(compatibility != QoSCompatibility.ERROR)
