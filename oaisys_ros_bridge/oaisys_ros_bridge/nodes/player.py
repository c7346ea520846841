"""Node ``oaisys_player``: publishes a bag again."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from oaisys_core.errors import InvalidInputError, NotFoundError
from oaisys_ros_bridge.bag import RecordedTopic
from oaisys_ros_bridge.bag_parameters import PLAYER
from oaisys_ros_bridge.bag_reader import BagReader, RecordedMessage, offered_qos
from oaisys_ros_bridge.message_definition import message_class
from oaisys_ros_bridge.node_parameters import ParameterNode
from oaisys_ros_bridge.node_process import run_node

CLOCK = "/clock"
USUAL_DEPTH = 10
"""Of a queue whose depth is not known."""
LOOK_PERIOD_S = 0.1
CALM_S = 3.0
"""Subscribers count as complete when none has come for this long; on a busy machine discovery takes
that long to tell of the first."""
LONGEST_WAIT_S = 20.0
"""For subscribers that are known of, but not matched."""
ACKNOWLEDGED_S = 10.0
"""How long subscribers may take at the end to confirm what they got."""


class PlayerNode(ParameterNode, Node):
    """Publishes recorded messages as they are, in their pace and with their quality of service.

    It waits for the subscribers that it can see, prints ``playing: PATH``, plays, and ends. Its
    parameters are the table `PLAYER`.
    """

    def __init__(self, stop: threading.Event, **defaults: Any) -> None:
        """Offer the topics of a bag and begin to play.

        Args:
            stop: Set when all was played.
            defaults: Of the parameters, instead of the table's.

        Raises:
            InvalidInputError: There is no such bag; a parameter is bad.
            NotFoundError: A topic that is asked for is not in it.
        """
        super().__init__("oaisys_player")
        values = self.declare_table(PLAYER, **defaults)
        if not values["path"]:
            raise InvalidInputError("path", "", "a bag's folder, or a .mcap file")
        self._path = Path(values["path"])
        self._bag = BagReader(self._path)
        self._stop = stop
        self._closing = threading.Event()
        self._rate = float(values["rate"])
        self._clock_period_s = 1 / values["clock_hz"] if values["clock_hz"] else 0.0
        self._next_tick_s = 0.0
        wanted = {name for name in values["topics"] if name}
        self._bag.require(wanted)
        self._publishers_by_topic = self._offer(wanted or self._bag.topics.keys())
        self._clock_publisher = self.create_publisher(Clock, CLOCK, 1) if self._ticks else None
        self.count = 0
        self._player = threading.Thread(target=self._run, name="player", daemon=True)
        self._player.start()

    @property
    def _ticks(self) -> bool:
        """Whether the recording's time is told."""
        return self._clock_period_s > 0

    def close(self) -> None:
        """Stop playing."""
        self._closing.set()
        self._player.join()

    def _offer(self, topics: Any) -> Mapping[str, Publisher]:
        """Return publishers of those topics whose types are installed."""
        publishers = {}
        for name in sorted(topics):
            if name == CLOCK and self._ticks:
                continue  # it would tell another time
            topic = self._bag.topics[name]
            try:
                kind = message_class(topic.type_name)
            except NotFoundError as error:
                self.get_logger().warning(f"{name} is not played: {error}")
                continue
            publishers[name] = self.create_publisher(kind, name, _profile(topic))
        return publishers

    def _run(self) -> None:
        try:
            self._wait_for_subscribers()
            sys.stdout.write(f"playing: {self._path}\n")
            sys.stdout.flush()
            self._play()
            while self.parameters["loop"] and not self._closing.is_set():
                self._play()
            self._wait_for_acknowledgements()
            self.get_logger().info(f"{self.count} messages of {self._path} are played")
        finally:
            self._stop.set()

    def _play(self) -> None:
        first_ns = None
        start_s = time.monotonic()
        self._next_tick_s = start_s
        for message in self._bag.messages(self._publishers_by_topic.keys()):
            first_ns = message.received_ns if first_ns is None else first_ns
            since_s = (message.received_ns - first_ns) / 1e9 / self._rate
            if not self._wait_until(start_s + since_s, message):
                return
            self._publishers_by_topic[message.topic].publish(message.data)
            self.count += 1

    def _wait_until(self, due_s: float, message: RecordedMessage) -> bool:
        """Wait for a message's time, telling it on the way; return whether to go on."""
        while self._clock_publisher and self._next_tick_s <= due_s:
            if self._closing.wait(max(0.0, self._next_tick_s - time.monotonic())):
                return False
            ahead_ns = int((due_s - self._next_tick_s) * self._rate * 1e9)
            now = Time(nanoseconds=message.received_ns - ahead_ns).to_msg()
            self._clock_publisher.publish(Clock(clock=now))
            self._next_tick_s += self._clock_period_s
        return not self._closing.wait(max(0.0, due_s - time.monotonic()))

    def _wait_for_subscribers(self) -> None:
        """Wait until every subscriber that discovery tells of is matched, and no more come."""
        end_s = time.monotonic() + LONGEST_WAIT_S
        calm_since_s, before = time.monotonic(), -1
        while time.monotonic() < end_s and not self._closing.wait(LOOK_PERIOD_S):
            publishers = self._publishers_by_topic
            matched = {name: p.get_subscription_count() for name, p in publishers.items()}
            known = {name: self.count_subscribers(p.topic_name) for name, p in publishers.items()}
            total = sum(matched.values())
            if matched != known or total != before:
                calm_since_s, before = time.monotonic(), total
            elif time.monotonic() > calm_since_s + CALM_S:
                return

    def _wait_for_acknowledgements(self) -> None:
        """Let what is still on its way arrive before the publishers go."""
        end_s = time.monotonic() + ACKNOWLEDGED_S
        for publisher in self._publishers_by_topic.values():
            left_s = max(0.0, end_s - time.monotonic())
            if not self._closing.is_set():
                publisher.wait_for_all_acked(Duration(seconds=left_s))


def _profile(topic: RecordedTopic) -> QoSProfile:
    offered = offered_qos(topic.qos_profiles)
    reliable, latched = offered.reliable, offered.transient_local
    return QoSProfile(
        depth=offered.depth or USUAL_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def main(arguments: Sequence[str] | None = None, **defaults: Any) -> int:
    """Play a bag to its end, or until told to end."""
    stop = threading.Event()
    return run_node(lambda: PlayerNode(stop, **defaults), arguments, stop=stop)


if __name__ == "__main__":
    sys.exit(main())
