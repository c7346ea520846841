"""Back-pressure of our own readers: the bridge waits for the mapper and recorders, for nobody else.

Each of them reports on ``~/receipts`` up to which sample it has taken all messages. A publisher
holds the last `SENSOR_DEPTH` messages of a topic: the middleware can resend what a reader lacks, as
long as the reader is not further behind than that.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import Sample
from oaisys_msgs.msg import SampleReceipt
from oaisys_ros_bridge.bridge.requests import Cancellation
from oaisys_ros_bridge.conversions import nanoseconds
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, WINDOW
from oaisys_ros_bridge.subscribing.foreign_names import check_name, counts_of_losses
from oaisys_ros_bridge.subscribing.ledger_state import LedgerState, SampleName, shortfall
from oaisys_ros_bridge.timers import steady_timer

ReaderKey = tuple[str, int]
"""Full name of a reader's node, and the number by which nodes of one name differ."""

WAIT = "wait"
PRESENCE_PERIOD_S = 1.0
"""Between two checks which readers have gone without their last receipt."""
LOOK_UP_S = 0.1
"""Between two checks of a waiting thread whether it shall end."""
MAX_OWED = 10_000
"""Samples that are remembered for a reader that takes none."""
MAX_READERS = 32
"""Nodes whose receipts count at a time."""
MAX_ENDED = 1000
"""Readers that are remembered after their end."""
REFUSED_RECEIPTS = "refused receipts"
"""Key of the number of receipts that do not count; missing: all do."""


@dataclass
class _Reader:
    """A node that sends receipts.

    Attributes:
        label: Its full name, with a number if another node has it, too.
        owed: Numbers and names of the samples whose receipt is missing, oldest first.
        state: What its last receipt says.
        taken_s: When its last receipt came.
        receipt_s: When its last receipt came, whether it takes a sample or not.
        stalled_s: Since when it is not waited for; None: it is.
        is_known: Whether the middleware has shown its publisher of receipts.
    """

    label: str
    owed: deque[tuple[int, SampleName]] = field(default_factory=lambda: deque(maxlen=MAX_OWED))
    state: LedgerState = field(default_factory=LedgerState)
    taken_s: float = field(default_factory=time.monotonic)
    receipt_s: float = field(default_factory=time.monotonic)
    stalled_s: float | None = None
    is_known: bool = False


def state_of(receipt: SampleReceipt) -> LedgerState:
    """Return the counts in a receipt."""
    stamp_ns = nanoseconds(receipt.header.stamp)
    return LedgerState(
        receipt.samples,
        receipt.samples,
        receipt.samples_incomplete,
        counts_of_losses(receipt.lost),
        SampleName(receipt.batch_id, receipt.sample_id, stamp_ns) if stamp_ns else None,
        counts_of_losses(receipt.lost_by_middleware),
    )


class BackPressure:
    """The readers, and up to which sample each is done; safe to use from any thread.

    Args:
        node: The bridge.
        settings: Returns its parameters.
    """

    def __init__(self, node: Node, settings: Settings) -> None:
        self._node = node
        self._settings = settings
        self._changed = threading.Condition()
        self._readers: dict[ReaderKey, _Reader] = {}
        self._gone: dict[ReaderKey, str] = {}
        self._ended: dict[ReaderKey, tuple[int, _Reader]] = {}
        self._number = 0
        self._refused = 0
        self._subscription = node.create_subscription(
            SampleReceipt,
            "~/receipts",
            self._on_receipt,
            LATCHED_HISTORY_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        steady_timer(node, PRESENCE_PERIOD_S, self._drop_gone, MutuallyExclusiveCallbackGroup())

    def begin(self) -> None:
        """Count a sample that begins to be published, whether it gets complete or not."""
        with self._changed:
            self._number += 1

    def expect(self, sample: Sample, stamp: Time) -> None:
        """Expect receipts of the newest sample, which is about to be announced."""
        name = SampleName(sample.batch_id, sample.sample_id, nanoseconds(stamp))
        with self._changed:
            for reader in self._readers.values():
                reader.owed.append((self._number, name))

    def wait_for_room(self, cancellation: Cancellation) -> None:
        """Wait until another sample can cost no reader a message.

        A reader that has taken nothing for ``readers.timeout_s`` is not waited for again until it
        takes a sample.

        Raises:
            CancelledError: The work was cancelled.
        """
        self._wait_for(self._number + 1 - WINDOW, cancellation)

    def wait_until_taken(self, cancellation: Cancellation) -> None:
        """Wait until all samples so far were taken by all readers that are waited for.

        Raises:
            CancelledError: The work was cancelled.
        """
        self._wait_for(self._number, cancellation)

    @property
    def readers_are_behind(self) -> bool:
        """Whether a reader that is waited for has yet to take a sample."""
        with self._changed:
            return self._waits and bool(self._late(self._number))

    def states(self) -> dict[ReaderKey, LedgerState]:
        """Return the last counts of each reader."""
        with self._changed:
            return {key: reader.state for key, reader in self._readers.items()}

    def shortfalls(self, before: Mapping[ReaderKey, LedgerState]) -> list[str]:
        """Return a sentence for each reader that is behind, has gone, or lost messages since."""
        with self._changed:
            found = [sentence for key, sentence in self._gone.items() if key in before]
            for key, (taken, reader) in self._ended.items():
                if key in before and taken < self._number:
                    found.append(f"{reader.label} had ended before the last sample")
                if key in before and (lost := shortfall(reader.state.since(before[key]))):
                    found.append(f"{reader.label}: {lost}")
            for key, reader in self._readers.items():
                in_flight = 0 if self._waits else WINDOW
                if len(reader.owed) > in_flight:
                    _, oldest = reader.owed[0]
                    behind = f"{len(reader.owed)}, from {oldest} on"
                    found.append(f"{reader.label} has not taken {behind}")
                if lost := shortfall(reader.state.since(before.get(key, LedgerState()))):
                    found.append(f"{reader.label}: {lost}")
            return found

    def diagnostics(self) -> tuple[Sequence[str], dict[str, object]]:
        """Return the problems, one sentence each, and all values by name."""
        with self._changed:
            wrong: list[str] = []
            values: dict[str, object] = {}
            if self._refused:
                why = "of too many readers, or of too long names"
                wrong.append(f"{self._refused} receipts do not count: {why}")
                values[REFUSED_RECEIPTS] = self._refused
            for reader in self._readers.values():
                name = reader.label
                if reader.stalled_s is not None:
                    stalled_s = time.monotonic() - reader.stalled_s
                    wrong.append(f"{name} is not waited for, for {stalled_s:.0f} s now")
                if lost := shortfall(reader.state):
                    wrong.append(f"{name}: {lost}")
                values |= {
                    f"{name} samples": reader.state.settled,
                    f"{name} behind": len(reader.owed),
                    f"{name} incomplete": reader.state.incomplete,
                }
                values |= {f"{name} lost {w}": n for w, n in reader.state.lost.items()}
                values |= {
                    f"{name} lost by middleware {w}": n
                    for w, n in reader.state.lost_by_middleware.items()
                }
            return wrong, values

    @property
    def _waits(self) -> bool:
        return bool(self._settings()["readers.when_behind"] == WAIT)

    def _wait_for(self, number: int, cancellation: Cancellation) -> None:
        if not self._waits:
            return
        timeout_s, begun_s = self._settings()["readers.timeout_s"], time.monotonic()
        with self._changed:
            while late := self._late(number):
                cancellation.check()
                now_s = time.monotonic()
                self._give_up([r for r in late if now_s - max(begun_s, r.taken_s) >= timeout_s])
                self._changed.wait(LOOK_UP_S)

    def _late(self, number: int) -> list[_Reader]:
        """Return the readers that are waited for and have not taken all up to a sample."""
        return [
            reader
            for reader in self._readers.values()
            if reader.stalled_s is None and reader.owed and reader.owed[0][0] <= number
        ]

    def _give_up(self, readers: Sequence[_Reader]) -> None:
        for reader in readers:
            reader.stalled_s = time.monotonic()
            _, oldest = reader.owed[0]
            self._node.get_logger().warning(
                f"{reader.label} has not taken {oldest}: it is not waited for any more"
            )

    def _drop_gone(self) -> None:
        """Drop the readers whose publisher of receipts is no longer there: they were killed.

        Of several nodes of one name, those are dropped whose last receipts are the oldest.
        """
        publishers = self._node.get_publishers_info_by_topic(self._subscription.topic_name)
        counts = Counter(f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in publishers)
        with self._changed:
            for node in {node for node, _ in self._readers}:
                keys = sorted(
                    (key for key in self._readers if key[0] == node),
                    key=lambda key: self._readers[key].receipt_s,
                )
                if counts[node] >= len(keys):
                    for key in keys:
                        self._readers[key].is_known = True
                known = [key for key in keys if self._readers[key].is_known]
                for key in known[: len(keys) - counts[node]]:
                    self._drop(key)
            self._changed.notify_all()

    def _drop(self, key: ReaderKey) -> None:
        reader = self._readers.pop(key)
        behind = f" before it had taken {reader.owed[0][1]}" if reader.owed else ""
        self._gone[key] = f"{reader.label} has gone without a word{behind}"
        _keep_newest(self._gone)
        self._node.get_logger().warning(f"{self._gone[key]}: it is no longer one of the readers")

    def _note_end(self, key: ReaderKey, receipt: SampleReceipt) -> None:
        """Note up to which sample a reader that ends has taken all, and what it has lost."""
        reader = self._readers.pop(key)
        reader.state = state_of(receipt)
        self._ended[key] = (reader.owed[0][0] - 1 if reader.owed else self._number), reader
        _keep_newest(self._ended)

    def _make_room(self, node: str) -> None:
        """Forget a reader that the middleware has not shown, where there are too many.

        Raises:
            InvalidInputError: It has shown all of them.
        """
        if len(self._readers) < MAX_READERS:
            return
        unknown = [key for key, reader in self._readers.items() if not reader.is_known]
        if not unknown:
            raise InvalidInputError("node", node, f"one of at most {MAX_READERS} readers")
        self._refused += 1
        del self._readers[min(unknown, key=lambda key: self._readers[key].receipt_s)]

    def _new_reader(self, node: str) -> _Reader:
        labels = {reader.label for reader in self._readers.values()}
        others = (f"{node} ({number})" for number in count(2))
        return _Reader(next(label for label in chain([node], others) if label not in labels))

    def _on_receipt(self, receipt: SampleReceipt) -> None:
        try:
            check_name("node", receipt.node)
            self._take(receipt)
        except InvalidInputError as error:
            with self._changed:
                self._refused += 1
            self._node.get_logger().warning(
                f"a receipt is refused: {error}", throttle_duration_sec=10.0
            )

    def _take(self, receipt: SampleReceipt) -> None:
        key = receipt.node, receipt.instance
        with self._changed:
            if receipt.ended:
                if key in self._readers:
                    self._note_end(key, receipt)
                self._changed.notify_all()
                return
            if key not in self._readers:
                self._make_room(receipt.node)
                self._readers[key] = self._new_reader(receipt.node)
            reader = self._readers[key]
            reader.state = state = state_of(receipt)
            reader.receipt_s = time.monotonic()
            if any(name == state.last for _, name in reader.owed):
                reader.taken_s = time.monotonic()
                while reader.owed[0][1] != state.last:
                    reader.owed.popleft()
                reader.owed.popleft()
                if reader.stalled_s is not None:
                    reader.stalled_s = None
                    self._node.get_logger().info(f"{reader.label} takes samples again")
            self._changed.notify_all()


def _keep_newest(ended: dict[ReaderKey, Any]) -> None:
    """Forget the reader that ended first, where there are too many."""
    if len(ended) > MAX_ENDED:
        del ended[next(iter(ended))]
