"""Brings together messages that carry the same stamp."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Any

PENDING = 32
"""Stamps that may be incomplete at a time; the oldest is given up first."""


class ExactSynchronizer:
    """Collects one message of each kind by exact stamp.

    Args:
        required: Kinds without which a stamp is not complete.
        wanted: Kinds that are waited for until `release_older_than` gives them up.
        counted: Kinds whose loss counts.
        on_dropped: Told the stamps whose loss counts.

    Attributes:
        given_up: How many stamps with a counted kind never got complete.
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
        """Take a message in; return all of its stamp, by kind, if it was the last one missing."""
        _, messages = self._pending.setdefault(stamp_ns, (now_s, {}))
        messages[kind] = message
        if messages.keys() >= self._expected.get(stamp_ns, self._complete):
            self._forget(stamp_ns)
            return messages
        while len(self._pending) > PENDING:
            self.drop([next(iter(self._pending))])
        return None

    def expect(self, stamp_ns: int, kinds: Iterable[str]) -> dict[str, Any] | None:
        """Settle which wanted kinds a stamp will have; return all of it if that has come."""
        self._expected[stamp_ns] = self._required | (self._complete & frozenset(kinds))
        while len(self._expected) > PENDING:
            del self._expected[min(self._expected)]
        _, messages = self._pending.get(stamp_ns, (0.0, {}))
        if not messages or not messages.keys() >= self._expected[stamp_ns]:
            return None
        self._forget(stamp_ns)
        return messages

    def release_older_than(self, first_s: float) -> list[tuple[int, dict[str, Any]]]:
        """Return what is complete but for wanted kinds and was begun before ``first_s``."""
        released = [
            (stamp_ns, messages)
            for stamp_ns, (begun_s, messages) in self._pending.items()
            if begun_s < first_s and messages.keys() >= self._required
        ]
        for stamp_ns, _ in released:
            self._forget(stamp_ns)
        return released

    def release(self, stamp_ns: int) -> dict[str, Any] | None:
        """Return what there is of a stamp, if only wanted kinds are missing, and forget it."""
        _, messages = self._pending.get(stamp_ns, (0.0, {}))
        if not messages or not messages.keys() >= self._required:
            return None
        self._forget(stamp_ns)
        return messages

    def drop(self, stamps_ns: Iterable[int]) -> None:
        """Give stamps up; those of which an image had come are counted."""
        for stamp_ns in stamps_ns:
            _, messages = self._pending.get(stamp_ns, (0.0, {}))
            self._forget(stamp_ns)
            if messages.keys() & self._counted:
                self.given_up += 1
                self._on_dropped(stamp_ns)

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of which something has come, but not all."""
        return tuple(self._pending)

    def clear(self) -> None:
        """Forget what is incomplete, and the count of what was given up."""
        self._pending.clear()
        self._expected.clear()
        self.given_up = 0

    def _forget(self, stamp_ns: int) -> None:
        self._pending.pop(stamp_ns, None)
        self._expected.pop(stamp_ns, None)
