"""The samples that bridges announce while a recorder runs, and which of their messages came."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup

from oaisys_core.errors import InvalidInputError
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.bags.losses import BagLosses, MissingNumbers
from oaisys_ros_bridge.bags.wire_names import WireNames
from oaisys_ros_bridge.conversions import NS_PER_S, nanoseconds
from oaisys_ros_bridge.qos import SMALL_MESSAGE_QOS
from oaisys_ros_bridge.subscribing.foreign_names import check_topics
from oaisys_ros_bridge.subscribing.sample_watch import (
    SAMPLE_INFO,
    SampleWatch,
    counting_losses,
    name_of,
)

PUBLISHING_S = 2.0
"""Longest time that publishing a sample takes beside rendering it."""


class AnnouncedSamples:
    """Counts which messages of the announced samples a recorder has not received.

    Args:
        wire: Lends the node that subscribes to a topic.
        is_recorded: Returns whether messages of a topic are recorded.

    Attributes:
        lost_by_middleware: Messages that the middleware has lost, by topic.
    """

    def __init__(self, wire: WireNames, is_recorded: Callable[[str], bool]) -> None:
        self._wire = wire
        self._is_recorded = is_recorded
        self._watches: dict[str, SampleWatch] = {}
        self._begun_ns: int | None = None
        self._counted: set[str] = set()
        self._announced: set[str] = set()
        self._missing_numbers = MissingNumbers()
        self.lost_by_middleware: Counter[str] = Counter()

    @property
    def is_any_open(self) -> bool:
        """Whether messages of an announced sample are still to come."""
        return any(watch.ledger.open for watch in self._watches.values())

    def follow(self, name: str) -> None:
        """Count losses from now on against the samples that a topic announces."""
        if name in self._watches or name.rpartition("/")[2] != SAMPLE_INFO:
            return
        node = self._wire.node_for(name)
        watch = SampleWatch(node, name, self.lost_by_middleware)
        # A new mapping, as other threads may be going through the old one.
        self._watches = {**self._watches, name: watch}
        if self._begun_ns is not None:
            watch.begin(self._begun_ns)
        node.create_subscription(
            SampleInfo,
            name,
            partial(self._on_sample_info, watch),
            SMALL_MESSAGE_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
            event_callbacks=counting_losses(self.lost_by_middleware, name, SMALL_MESSAGE_QOS),
        )

    def begin(self, now_ns: int, topics: Iterable[str]) -> None:
        """Expect all messages of samples that begin after ``now_ns``; ``topics`` are recorded."""
        self._begun_ns = now_ns
        self._counted |= set(topics)
        for watch in self._watches.values():
            watch.begin(now_ns)

    def arrive(self, topic: str, stamp_ns: int) -> None:
        """Note that a topic's message of the sample with a stamp was recorded."""
        self._counted.add(topic)
        for watch in self._watches.values():
            watch.ledger.arrive(topic, stamp_ns)

    def count_missing(self, topic: str, number: int) -> None:
        """Count the messages before this one that did not come; several publishers hide them."""
        missing = self._missing_numbers.before(topic, number)
        if missing and self._wire.count_publishers(topic) == 1:
            self.lost_by_middleware[topic] += missing

    def hear_newest(self, timeout_s: float) -> None:
        """Wait for the announcements of all samples so far, by what each bridge says."""
        for watch in self._watches.values():
            watch.hear_newest(timeout_s)

    def give_up_all(self) -> None:
        """Count what has not been received as lost."""
        for watch in self._watches.values():
            watch.ledger.give_up_all()

    def end(self) -> None:
        """Expect no more samples."""
        for watch in self._watches.values():
            watch.end()

    def losses(self, unwritten: Counter[str]) -> BagLosses:
        """Return all counts; ``unwritten`` are messages that came too late, by topic."""
        states = [watch.ledger.state for watch in self._watches.values()]
        return BagLosses.of(states, self.lost_by_middleware, unwritten)

    def _on_sample_info(
        self, watch: SampleWatch, info: SampleInfo, received: dict[str, int]
    ) -> None:
        """Expect the messages of a sample on the recorded topics."""
        announced = self._announced.union(info.topics)
        try:
            check_topics(announced)
        except InvalidInputError as error:
            self._wire.warn(f"{SAMPLE_INFO} is ignored: {error}")
            return
        self._announced = announced
        rendered_ns = int((info.render_time + PUBLISHING_S) * NS_PER_S)
        topics = self._due_topics(watch, info, received["source_timestamp"] - rendered_ns)
        watch.ledger.announce(name_of(info), info.sequence, topics & set(info.topics))

    def _due_topics(self, watch: SampleWatch, info: SampleInfo, begun_ns: int) -> set[str]:
        """Return the topics on which a sample has messages that this recorder can have received.

        They are all that it records if the sample began after it was ready; otherwise those that
        it knew. Of the first announced sample, messages may have been sent before it was there.
        """
        is_later = self._begun_ns is not None and begun_ns > self._begun_ns
        if watch.reader_was_first or is_later:
            return {topic for topic in info.topics if self._is_recorded(topic)}
        if watch.ledger.state.announced:
            return self._counted
        return watch.ledger.arrivals(nanoseconds(info.header.stamp))
