"""Node ``oaisys_player``: publishes the messages of a bag."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from oaisys_core.errors import (
    DeadlineExceededError,
    InvalidInputError,
    NotFoundError,
    OaisysError,
    quote,
)
from oaisys_core.files.folders import user_path
from oaisys_ros_bridge.bags.mcap_format.mcap_records import list_names
from oaisys_ros_bridge.bags.played_topic import PlayedTopic
from oaisys_ros_bridge.bags.reading import BagReader, RecordedMessage
from oaisys_ros_bridge.namespaces import CLOCK
from oaisys_ros_bridge.nodes.node_process import run_node
from oaisys_ros_bridge.nodes.program_arguments import node_parser, parse_arguments
from oaisys_ros_bridge.parameters.bags import PLAYER
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode

READER_POLL_PERIOD_S = 0.05
"""How often the number of readers is looked up while they are waited for."""
ACKNOWLEDGEMENT_TIMEOUT_S = 10.0
"""How long readers may take to acknowledge messages."""
MAX_TOPICS = 1000
"""Topics that are played; the time to make and to end their publishers grows with the square."""


class PlayerNode(ParameterNode, Node):
    """Publishes recorded messages at their times and with their quality of service.

    It waits for readers as ``wait_for_topics``, ``wait_for_readers`` and ``delay_s`` say, prints
    ``playing: PATH``, plays, and ends with a line for each topic: messages, readers,
    acknowledgements. Its parameters are the table `PLAYER`.

    Attributes:
        failed: Whether nothing was played, or there was no reader.
    """

    def __init__(self, stop: threading.Event, **defaults: Any) -> None:
        """Make the publishers of a bag's topics and begin to play.

        Args:
            stop: Set when all has been played.
            defaults: Of the parameters, instead of the table's.

        Raises:
            InvalidInputError: There is no such bag, it has too many topics, or a parameter is
                wrong.
            NotFoundError: A requested topic is not in it, or its type is not installed, or no topic
                can be played.
        """
        super().__init__("oaisys_player")
        values = self.declare_table(PLAYER, **defaults)
        if not values["path"]:
            raise InvalidInputError("path", "", "a bag's folder, or a .mcap file")
        self._path = user_path(values["path"], "path")
        self._bag = BagReader(self._path)
        self._stop = stop
        self._closing = threading.Event()
        self._rate = float(values["rate"])
        self._clock_period_s = 1 / values["clock_hz"] if values["clock_hz"] else 0.0
        self._next_tick_s = 0.0
        wanted = {name for name in values["topics"] if name}
        awaited = {name for name in values["wait_for_topics"] if name}
        self._bag.require(wanted | awaited)
        played = (wanted or self._bag.topics.keys()) | awaited
        if len(played) > MAX_TOPICS:
            expected = f"at most {MAX_TOPICS} of them, chosen by --topics"
            raise InvalidInputError("topics", f"{len(played)} topics of {self._path}", expected)
        self._topics = self._make_topics(played, wanted | awaited)
        required_names = awaited or wanted
        self._awaits_readers = bool(awaited or values["wait_for_readers"])
        self._required = [topic for name, topic in self._topics.items() if name in required_names]
        self._clock_publisher = (
            self.create_publisher(Clock, CLOCK, 1) if self._publishes_clock else None
        )
        self.failed = False
        self._player = threading.Thread(target=self._run, name="player", daemon=True)
        self._player.start()

    @property
    def _publishes_clock(self) -> bool:
        """Whether the recording's time is published."""
        return self._clock_period_s > 0

    def close(self) -> None:
        """Stop playing."""
        self._closing.set()
        self._player.join()

    def _make_topics(
        self, names: Iterable[str], required: Collection[str]
    ) -> dict[str, PlayedTopic]:
        """Return the publishers of topics, by their names in the bag; fewer once it shall end.

        Raises:
            InvalidInputError: The name of a required one cannot be used.
            NotFoundError: The type of a required one is not installed, or no topic can be played.
        """
        played: dict[str, PlayedTopic] = {}
        skipped: list[str] = []
        for name in sorted(names):
            if name == CLOCK and self._publishes_clock:
                continue  # its time would contradict the published one
            if self._stop.is_set():
                self._closing.set()
                return played
            try:
                played[name] = PlayedTopic(self, self._bag.topics[name], ACKNOWLEDGEMENT_TIMEOUT_S)
            except (InvalidInputError, NotFoundError) as error:
                if name in required:
                    raise
                skipped.append(f"{quote(name)} is not played: {error}")
        if skipped and not played:
            raise NotFoundError(f"{self._path} has no topic that can be played: {skipped[0]}")
        for sentence in skipped:
            self.get_logger().warning(sentence)
        return played

    def _run(self) -> None:
        self.failed = True
        try:
            self._wait_for_readers()
            _say(f"playing: {self._path}")
            self._play()
            while self.parameters["loop"] and not self._closing.is_set():
                self._play()
            self._report()
        except OaisysError as error:
            self.get_logger().error(str(error))
        finally:
            self._stop.set()

    def _play(self) -> None:
        first_ns = None
        start_s = time.monotonic()
        self._next_tick_s = start_s
        for message in self._bag.messages(self._topics.keys()):
            first_ns = message.received_ns if first_ns is None else first_ns
            since_s = (message.received_ns - first_ns) / 1e9 / self._rate
            if not self._wait_until(start_s + since_s, message):
                return
            self._topics[message.topic].publish(message.data)

    def _wait_until(self, due_s: float, message: RecordedMessage) -> bool:
        """Wait until a message is due, publishing ``/clock``; return whether to go on."""
        while self._clock_publisher and self._next_tick_s <= due_s:
            if self._closing.wait(max(0.0, self._next_tick_s - time.monotonic())):
                return False
            ahead_ns = int((due_s - self._next_tick_s) * self._rate * 1e9)
            now = Time(nanoseconds=message.received_ns - ahead_ns).to_msg()
            self._clock_publisher.publish(Clock(clock=now))
            self._next_tick_s += self._clock_period_s
        return not self._closing.wait(max(0.0, due_s - time.monotonic()))

    def _wait_for_readers(self) -> None:
        """Wait for the required readers, then for the delay; warn of topics without a reader.

        With a delay, readers are waited for only where ``wait_for_readers`` or ``wait_for_topics``
        asks for them.

        Raises:
            DeadlineExceededError: They did not come in time.
        """
        if self._awaits_readers or not self.parameters["delay_s"]:
            end_s = time.monotonic() + self.parameters["wait_timeout_s"]
            if missing := self._missing():
                self.get_logger().info(f"waiting for {missing}")
            while self._missing() and time.monotonic() < end_s:
                if self._closing.wait(READER_POLL_PERIOD_S):
                    return
            self._require_readers()
        self._closing.wait(self.parameters["delay_s"])
        for topic in self._topics.values():
            if self._closing.is_set():
                return
            if not topic.readers:
                self.get_logger().warning(f"nobody reads {topic.name}")

    def _missing(self) -> str:
        """Return, in words, which readers are still missing; empty if none."""
        least = self.parameters["wait_for_readers"]
        nodes = set().union(*(topic.reading_nodes for topic in self._topics.values()))
        if len(nodes) < least:
            return f"readers: {len(nodes)} of {least} nodes are there"
        if least and (unmatched := [t.name for t in self._topics.values() if not t.is_matched]):
            return f"the subscriptions of {list_names(unmatched)} to be matched"
        if least and not self._required:
            return ""
        topics = self._required or self._topics.values()
        names = [topic.name for topic in topics if not topic.readers]
        return f"readers of {list_names(names)}" if names else ""

    def _require_readers(self) -> None:
        """Raise `DeadlineExceededError` where the required readers, or all of them, are missing."""
        missing = self._missing()
        is_optional = not self._required and not self.parameters["wait_for_readers"]
        if missing and not (is_optional and any(t.readers for t in self._topics.values())):
            waited_s = self.parameters["wait_timeout_s"]
            hint = "--delay SECONDS plays without them"
            if self._awaits_readers:
                hint = f"without --wait-for and --wait-for-topic, {hint}"
            raise DeadlineExceededError(f"waited {waited_s:g} s for {missing}: {hint}")

    def _report(self) -> None:
        """Wait for the last acknowledgements and print the counts of each topic."""
        end_s = time.monotonic() + ACKNOWLEDGEMENT_TIMEOUT_S
        for topic in self._topics.values():
            left_s = 0.0 if self._closing.is_set() else max(0.0, end_s - time.monotonic())
            _say(topic.finish(left_s))
        with_reader = sum(topic.with_reader for topic in self._topics.values())
        sent = sum(topic.sent for topic in self._topics.values())
        if sent and not with_reader:
            raise NotFoundError(f"{self._path} was played to nobody: no topic had a reader")
        self.failed = False


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main(arguments: Sequence[str] | None = None, **defaults: Any) -> int:
    """Play a bag to its end, or until SIGINT or SIGTERM; return 1 if it had no reader."""
    _, arguments = parse_arguments(node_parser("player"), arguments)
    stop = threading.Event()
    made: list[PlayerNode] = []

    def make_node() -> PlayerNode:
        made.append(PlayerNode(stop, **defaults))
        return made[0]

    status = run_node(make_node, arguments, stop=stop)
    return status or int(made[0].failed)


if __name__ == "__main__":
    sys.exit(main())
