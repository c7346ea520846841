"""Back-pressure of our own readers: the bridge waits for the mapper and recorders, for nobody else.

Each of them reports on ``~/receipts`` up to which sample it has taken all messages. A publisher
holds the last `SENSOR_DEPTH` messages of a topic: the middleware can resend what a reader lacks, as
long as the reader is not further behind than that.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from builtin_interfaces.msg import Time
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from oaisys_core.types import Sample
from oaisys_msgs.msg import SampleReceipt
from oaisys_ros_bridge.bridge.requests import Cancellation
from oaisys_ros_bridge.conversions import nanoseconds
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, WINDOW
from oaisys_ros_bridge.subscribing.sample_ledger import LedgerState, SampleName, shortfall

WAIT = "wait"
LOOK_UP_S = 0.1
"""Between two checks of a waiting thread whether it shall end."""
MOST_OWED = 10_000
"""Samples that are remembered for a reader that takes none."""


@dataclass
class _Reader:
    """A node that sends receipts.

    Attributes:
        owed: Numbers and names of the samples whose receipt is missing, oldest first.
        state: What its last receipt says.
        taken_s: When its last receipt came.
        stalled_s: Since when it is not waited for; None: it is.
    """

    owed: deque[tuple[int, SampleName]] = field(default_factory=lambda: deque(maxlen=MOST_OWED))
    state: LedgerState = field(default_factory=LedgerState)
    lost_by_middleware: Mapping[str, int] = field(default_factory=dict)
    taken_s: float = field(default_factory=time.monotonic)
    stalled_s: float | None = None


def state_of(receipt: SampleReceipt) -> LedgerState:
    """Return the counts in a receipt."""
    stamp_ns = nanoseconds(receipt.header.stamp)
    return LedgerState(
        receipt.samples,
        receipt.samples,
        receipt.samples_incomplete,
        {loss.what: loss.count for loss in receipt.lost},
        SampleName(receipt.batch_id, receipt.sample_id, stamp_ns) if stamp_ns else None,
    )


class Readers:
    """The readers, and up to which sample each is done; safe to use from any thread.

    Args:
        node: The bridge.
        settings: Returns its parameters.
    """

    def __init__(self, node: Node, settings: Settings) -> None:
        self._node = node
        self._settings = settings
        self._changed = threading.Condition()
        self._readers: dict[str, _Reader] = {}
        self._number = 0
        node.create_subscription(
            SampleReceipt,
            "~/receipts",
            self._on_receipt,
            LATCHED_HISTORY_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

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
    def are_behind(self) -> bool:
        """Whether a reader that is waited for has yet to take a sample."""
        with self._changed:
            return self._waits and bool(self._late(self._number))

    def states(self) -> dict[str, LedgerState]:
        """Return the last counts of each reader, by its name."""
        with self._changed:
            return {name: reader.state for name, reader in self._readers.items()}

    def shortfalls(self, before: Mapping[str, LedgerState]) -> list[str]:
        """Return a sentence for each reader that is behind or has lost messages since then."""
        with self._changed:
            found = []
            for name, reader in self._readers.items():
                in_flight = 0 if self._waits else WINDOW
                if len(reader.owed) > in_flight:
                    _, oldest = reader.owed[0]
                    found.append(f"{name} has not taken {len(reader.owed)}, from {oldest} on")
                if lost := shortfall(reader.state.since(before.get(name, LedgerState()))):
                    found.append(f"{name}: {lost}")
            return found

    def diagnostics(self) -> tuple[Sequence[str], dict[str, object]]:
        """Return the problems, one sentence each, and all values by name."""
        with self._changed:
            wrong: list[str] = []
            values: dict[str, object] = {}
            for name, reader in self._readers.items():
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
                    for w, n in reader.lost_by_middleware.items()
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
                last_s = [max(begun_s, self._readers[name].taken_s) for name in late]
                self._give_up(
                    [n for n, s in zip(late, last_s, strict=True) if now_s - s >= timeout_s]
                )
                self._changed.wait(LOOK_UP_S)

    def _late(self, number: int) -> list[str]:
        """Return the readers that are waited for and have not taken all up to a sample."""
        return [
            name
            for name, reader in self._readers.items()
            if reader.stalled_s is None and reader.owed and reader.owed[0][0] <= number
        ]

    def _give_up(self, names: Sequence[str]) -> None:
        for name in names:
            reader = self._readers[name]
            reader.stalled_s = time.monotonic()
            _, oldest = reader.owed[0]
            self._node.get_logger().warning(
                f"{name} has not taken {oldest}: it is not waited for any more"
            )

    def _on_receipt(self, receipt: SampleReceipt) -> None:
        with self._changed:
            if receipt.ended:
                self._readers.pop(receipt.node, None)
                self._changed.notify_all()
                return
            state = state_of(receipt)
            if receipt.node not in self._readers or state.last is None:
                self._readers[receipt.node] = _Reader()  # it is new, or was restarted
            reader = self._readers[receipt.node]
            reader.state = state
            reader.lost_by_middleware = {x.what: x.count for x in receipt.lost_by_middleware}
            if any(name == state.last for _, name in reader.owed):
                reader.taken_s = time.monotonic()
                while reader.owed[0][1] != state.last:
                    reader.owed.popleft()
                reader.owed.popleft()
                if reader.stalled_s is not None:
                    reader.stalled_s = None
                    self._node.get_logger().info(f"{receipt.node} takes samples again")
            self._changed.notify_all()
