"""Subscriptions to topics under the names that they have on the wire."""

from __future__ import annotations

from rclpy.node import Node


class WireNames:
    """Lends a node to which a topic's name means the topic that has it on the wire.

    A node's remapping rules apply to every name that it is given, also to those that discovery has
    told it. Where they would change one, a second node without rules, which has the same name,
    takes the first one's place.

    Args:
        node: It must be on an executor when a second node is needed.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._without_rules: Node | None = None

    def node_for(self, topic: str) -> Node:
        """Return the node for a topic's full name."""
        if self._node.resolve_topic_name(topic) == topic:
            return self._node
        if self._without_rules is None:
            self._without_rules = Node(
                self._node.get_name(),
                namespace=self._node.get_namespace(),
                context=self._node.context,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
            )
            if self._node.executor is not None:
                self._node.executor.add_node(self._without_rules)
        return self._without_rules

    def count_publishers(self, topic: str) -> int:
        """Return how many publishers a topic has by its full name."""
        return int(self.node_for(topic).count_publishers(topic))

    def warn(self, line: str) -> None:
        """Log a warning, not more than one every ten seconds."""
        self._node.get_logger().warning(line, throttle_duration_sec=10.0)

    def destroy(self) -> None:
        """Destroy the second node."""
        if self._without_rules is not None:
            self._without_rules.destroy_node()
