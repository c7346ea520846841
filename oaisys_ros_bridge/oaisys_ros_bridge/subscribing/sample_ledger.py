"""Which announced samples are complete, and what is missing of the others.

``~/sample_info`` announces every sample that was published completely. The middleware keeps the
order of the messages of a topic, so a message counts as lost once that of a later sample has come,
or after `LOST_AFTER_S`. If it comes later after all, it no longer counts. No ROS in here.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from oaisys_ros_bridge.subscribing.ledger_state import LedgerState, SampleName

LOST_AFTER_S = 5.0
"""After an announcement. The middleware resends within 3 s what was not acknowledged."""

REMEMBERED = 4096
"""Stamps of messages whose sample is not announced (yet), or was found incomplete."""


@dataclass
class _Entry:
    """An announced sample that is still open: neither complete nor incomplete.

    Attributes:
        order: Which bridge announced it, and its number there.
        missing: What has not come.
        needed: Without which there is no result.
        result: What is made of the messages, and comes after them; empty: nothing is.
    """

    name: SampleName
    order: tuple[int, int]
    announced_s: float
    missing: set[str]
    needed: Collection[str]
    result: str
    lost: set[str] = field(default_factory=set)


class SampleLedger:
    """Counts the messages of announced samples; safe to use from any thread.

    Args:
        info_topic: Where samples are announced; named where announcements are lost.
        on_settled: Called after samples were closed, without a lock held.
        clock: Of seconds.
    """

    def __init__(
        self,
        info_topic: str,
        on_settled: Callable[[], object] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._info_topic = info_topic
        self._on_settled = on_settled
        self._clock = clock
        self._changed = threading.Condition()
        self._open: OrderedDict[int, _Entry] = OrderedDict()
        self._early: OrderedDict[int, set[str]] = OrderedDict()
        self._late: OrderedDict[int, set[str]] = OrderedDict()
        self._unseen: dict[int, frozenset[str]] = {}
        self._heard: OrderedDict[SampleName, None] = OrderedDict()
        self._bridge = 0
        self._sequence = 0
        self._topics: frozenset[str] = frozenset()
        self._from_first = False
        self._begun_at: tuple[int, frozenset[str]] = (1, frozenset())
        self._announced = self._settled = self._incomplete = 0
        self._lost: Counter[str] = Counter()
        self._last: _Entry | None = None

    @property
    def state(self) -> LedgerState:
        """Counts so far."""
        with self._changed:
            last = None if self._last is None else self._last.name
            return LedgerState(
                self._announced, self._settled, self._incomplete, dict(+self._lost), last
            )

    @property
    def expects_from_first(self) -> bool:
        """Whether the samples before the first announcement count as lost."""
        return self._from_first

    @property
    def open(self) -> int:
        """How many announced samples are open."""
        return len(self._open)

    def announce(
        self,
        name: SampleName,
        sequence: int,
        topics: Collection[str],
        *,
        needed: Collection[str] = (),
        result: str = "",
    ) -> None:
        """Add an announced sample.

        Args:
            name: Of the sample.
            sequence: Its number among all that were announced; 0: the sample id is taken instead.
            topics: What is to come of it.
            needed: Those of them without which there is no result.
            result: What is made of them, and `arrive`s as they do; empty: nothing is.
        """
        with self._changed:
            expected = {*topics, result} if result else set(topics)
            number = sequence or name.sample_id
            self._follow(number, frozenset(topics))
            missing = expected - self._early.pop(name.stamp_ns, set())
            order = self._bridge, number
            entry = _Entry(name, order, self._clock(), missing, needed, result)
            self._open[name.stamp_ns] = entry
            if number < self._sequence:  # its successor was announced before
                self._open = OrderedDict(sorted(self._open.items(), key=lambda each: each[1].order))
            for what in expected - missing:
                self._lose_before(entry, what)
            settled = self._settle()
            self._heard[name] = None
            while len(self._heard) > REMEMBERED:
                self._heard.popitem(last=False)
            self._changed.notify_all()
        self._report(settled)

    def wait_for_announcement(self, name: SampleName, sequence: int, timeout_s: float) -> None:
        """Wait until a sample is announced; count it, and those before it, as lost after a time.

        Before the first announcement nothing is counted, unless the reader was there before.

        Args:
            name: Of the sample.
            sequence: Its number among all that are announced.
            timeout_s: How long.
        """
        with self._changed:
            if self._changed.wait_for(lambda: name in self._heard, timeout_s):
                return
            self._begin_again_before(sequence)
            counts = bool(self._sequence or self._from_first)
            if counts:
                self._miss(range(self._sequence + 1, sequence + 1), self._topics)
            else:
                self._begun_at = sequence + 1, frozenset()
            self._sequence = sequence
        self._report(counts)

    def expect_from_first(self) -> None:
        """Count the samples before the first announcement as lost: the reader was there before."""
        with self._changed:
            if self._from_first:
                return
            self._from_first = True
            sequence, topics = self._begun_at
            self._miss(range(1, sequence), topics)
        self._report(sequence > 1)

    def arrive(self, what: str, stamp_ns: int) -> None:
        """Note that a message, or a result, has come."""
        with self._changed:
            entry = self._open.get(stamp_ns)
            if entry is not None:
                self._take(entry, what)
            elif stamp_ns in self._late:
                self._find(stamp_ns, what)
            else:
                self._early.setdefault(stamp_ns, set()).add(what)
                while len(self._early) > REMEMBERED:
                    self._early.popitem(last=False)
            settled = self._settle()
        self._report(settled)

    def arrivals(self, stamp_ns: int) -> set[str]:
        """Return what has come of a sample that is not announced yet."""
        with self._changed:
            return set(self._early.get(stamp_ns, ()))

    def give_up(self, stamp_ns: int, reason: str) -> None:
        """Note that there will be no result of a sample, and why."""
        with self._changed:
            entry = self._open.get(stamp_ns)
            if entry is not None and entry.result in entry.missing:
                entry.missing.discard(entry.result)
                entry.lost.add(reason)
            settled = self._settle()
        self._report(settled)

    def expire(self) -> None:
        """Count messages as lost that have not come for `LOST_AFTER_S`; results may take longer."""
        with self._changed:
            first_s = self._clock() - LOST_AFTER_S
            for entry in self._open.values():
                if entry.announced_s < first_s:
                    self._lose(entry, entry.missing - {entry.result})
            settled = self._settle()
        self._report(settled)

    def give_up_all(self) -> None:
        """Count everything that has not come as lost, at the end."""
        with self._changed:
            for entry in self._open.values():
                self._lose(entry, set(entry.missing))
            settled = self._settle()
        self._report(settled)

    def forget(self, before_ns: int | None = None) -> None:
        """Expect nothing more of samples before a stamp, or of any sample."""
        with self._changed:
            for stamp_ns, entry in self._open.items():
                if before_ns is None or stamp_ns < before_ns:
                    entry.missing.clear()
            settled = self._settle()
        self._report(settled)

    def wait(self, timeout_s: float) -> list[SampleName]:
        """Wait until all samples announced so far are closed; return those that are still open."""
        with self._changed:
            wanted = list(self._open.values())
            self._changed.wait_for(
                lambda: not any(self._open.get(e.name.stamp_ns) is e for e in wanted), timeout_s
            )
            return [e.name for e in wanted if self._open.get(e.name.stamp_ns) is e]

    def _follow(self, sequence: int, topics: frozenset[str]) -> None:
        """Count the announcements that were lost before this one."""
        self._announced += 1
        if sequence in self._unseen:  # taken by another thread, a moment later than its successor
            self._announced -= 1
            self._settled -= 1
            self._incomplete -= 1
            self._lost.subtract([self._info_topic, *self._unseen.pop(sequence)])
            return
        self._begin_again_before(sequence)
        if self._sequence or self._from_first:
            self._miss(range(self._sequence + 1, sequence), topics)
        else:
            self._begun_at = sequence, topics
        self._sequence, self._topics = sequence, topics

    def _begin_again_before(self, sequence: int) -> None:
        """Note another bridge where a number, with which that begins again, is not a new one."""
        if sequence <= self._sequence:
            self._unseen.clear()
            self._bridge += 1
            self._sequence = 0

    def _miss(self, sequences: range, topics: frozenset[str]) -> None:
        """Count samples as lost whose announcement has not come."""
        # len(sequences) fails beyond 2^63.
        count = max(sequences.stop - sequences.start, 0)
        self._announced += count
        self._settled += count
        self._incomplete += count
        for topic in (self._info_topic, *topics):
            self._lost[topic] += count
        first = max(sequences.start, sequences.stop - REMEMBERED)
        self._unseen |= dict.fromkeys(range(first, sequences.stop), topics)
        while len(self._unseen) > REMEMBERED:
            del self._unseen[next(iter(self._unseen))]

    def _take(self, entry: _Entry, what: str) -> None:
        entry.missing.discard(what)
        entry.lost.discard(what)
        self._lose_before(entry, what)

    def _lose_before(self, entry: _Entry, what: str) -> None:
        """Count a message as lost in all earlier samples; results come in any order."""
        if what == entry.result:
            return
        for earlier in self._open.values():
            if earlier is entry:
                return
            if what in earlier.missing:
                self._lose(earlier, {what})

    def _lose(self, entry: _Entry, what: set[str]) -> None:
        entry.missing -= what
        entry.lost |= what
        if entry.lost & set(entry.needed):
            entry.missing.discard(entry.result)

    def _find(self, stamp_ns: int, what: str) -> None:
        """Note that a lost message has come after all."""
        lost = self._late[stamp_ns]
        if what not in lost:
            return
        lost.discard(what)
        self._lost[what] -= 1
        if not lost:
            del self._late[stamp_ns]
            self._incomplete -= 1

    def _settle(self) -> bool:
        """Close the oldest samples that are no longer open; return whether there were any."""
        settled = False
        while self._open:
            stamp_ns, entry = next(iter(self._open.items()))
            if entry.missing:
                break
            del self._open[stamp_ns]
            settled = True
            self._settled += 1
            if self._last is None or entry.order >= self._last.order:
                self._last = entry
            if entry.lost:
                self._incomplete += 1
                self._lost.update(entry.lost)
                self._late[stamp_ns] = entry.lost
                while len(self._late) > REMEMBERED:
                    self._late.popitem(last=False)
        if settled:
            self._changed.notify_all()
        return settled

    def _report(self, settled: bool) -> None:
        if settled:
            self._on_settled()
