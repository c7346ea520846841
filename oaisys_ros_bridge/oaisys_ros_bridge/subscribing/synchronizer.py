"""Collects messages of the same stamp."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Any

PENDING = 32
"""Stamps that may be incomplete at a time; then the oldest is dropped."""


class ExactSynchronizer:
    """Collects one message of each kind by exact stamp.

    Args:
        required: Kinds without which a stamp is not complete.
        wanted: Kinds that are waited for until `release_older_than` or `release` ends the wait.
        counted: Kinds of which a dropped message counts.
        on_dropped: Called with each stamp that was dropped with a counted kind.

    Attributes:
        given_up: How many stamps were dropped with a counted kind.
    """

    def __init__(
        self,
        required: Iterable[str],
        wanted: Iterable[str] = (),
        counted: Iterable[str] = (),
        on_dropped: Callable[[int], object] = lambda _: None,
    ) -> None:
        self._on_dropped = on_dropped
        self._counted = frozenset(counted)
        self._required = frozenset(required)
        self._complete = self._required | frozenset(wanted)
        self._pending: OrderedDict[int, tuple[float, dict[str, Any]]] = OrderedDict()
        self._expected: dict[int, frozenset[str]] = {}
        self.given_up = 0

    def add(self, stamp_ns: int, kind: str, message: Any, now_s: float) -> dict[str, Any] | None:
        """Add a message; return all messages of its stamp, by kind, if that is complete now."""
        _, messages = self._pending.setdefault(stamp_ns, (now_s, {}))
        messages[kind] = message
        if messages.keys() >= self._expected.get(stamp_ns, self._complete):
            self._forget(stamp_ns)
            return messages
        while len(self._pending) > PENDING:
            self.drop([next(iter(self._pending))])
        return None

    def expect(self, stamp_ns: int, kinds: Iterable[str]) -> dict[str, Any] | None:
        """Set which wanted kinds a stamp will have; return its messages if it is complete."""
        self._expected[stamp_ns] = self._required | (self._complete & frozenset(kinds))
        while len(self._expected) > PENDING:
            del self._expected[min(self._expected)]
        _, messages = self._pending.get(stamp_ns, (0.0, {}))
        if not messages or not messages.keys() >= self._expected[stamp_ns]:
            return None
        self._forget(stamp_ns)
        return messages

    def release_older_than(self, first_s: float) -> list[tuple[int, dict[str, Any]]]:
        """Remove and return stamps from before ``first_s`` that lack wanted kinds only."""
        released = [
            (stamp_ns, messages)
            for stamp_ns, (begun_s, messages) in self._pending.items()
            if begun_s < first_s and messages.keys() >= self._required
        ]
        for stamp_ns, _ in released:
            self._forget(stamp_ns)
        return released

    def release(self, stamp_ns: int) -> dict[str, Any] | None:
        """Remove and return the messages of a stamp, if it lacks wanted kinds only."""
        _, messages = self._pending.get(stamp_ns, (0.0, {}))
        if not messages or not messages.keys() >= self._required:
            return None
        self._forget(stamp_ns)
        return messages

    def drop(self, stamps_ns: Iterable[int]) -> None:
        """Remove stamps; count those that have a message of a counted kind."""
        for stamp_ns in stamps_ns:
            _, messages = self._pending.get(stamp_ns, (0.0, {}))
            self._forget(stamp_ns)
            if messages.keys() & self._counted:
                self.given_up += 1
                self._on_dropped(stamp_ns)

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps that are incomplete."""
        return tuple(self._pending)

    def clear(self) -> None:
        """Remove all stamps, and reset the count."""
        self._pending.clear()
        self._expected.clear()
        self.given_up = 0

    def _forget(self, stamp_ns: int) -> None:
        self._pending.pop(stamp_ns, None)
        self._expected.pop(stamp_ns, None)
