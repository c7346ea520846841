"""Brings together messages that carry the same stamp."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from typing import Any

PENDING = 32
"""Stamps that may be incomplete at a time; the oldest is given up first."""


class ExactSynchronizer:
    """Collects one message of each kind by exact stamp.

    Args:
        required: Kinds without which a stamp is not complete.
        wanted: Kinds that are waited for until `release_older_than` gives them up.
    """

    def __init__(self, required: Iterable[str], wanted: Iterable[str] = ()) -> None:
        self._required = frozenset(required)
        self._complete = self._required | frozenset(wanted)
        self._pending: OrderedDict[int, tuple[float, dict[str, Any]]] = OrderedDict()

    def add(self, stamp_ns: int, kind: str, message: Any, now_s: float) -> dict[str, Any] | None:
        """Take a message in; return all of its stamp, by kind, if it was the last one missing."""
        _, messages = self._pending.setdefault(stamp_ns, (now_s, {}))
        messages[kind] = message
        if messages.keys() >= self._complete:
            del self._pending[stamp_ns]
            return messages
        while len(self._pending) > PENDING:
            self._pending.popitem(last=False)
        return None

    def release_older_than(self, first_s: float) -> list[tuple[int, dict[str, Any]]]:
        """Return what is complete but for wanted kinds and was begun before ``first_s``."""
        released = [
            (stamp_ns, messages)
            for stamp_ns, (begun_s, messages) in self._pending.items()
            if begun_s < first_s and messages.keys() >= self._required
        ]
        for stamp_ns, _ in released:
            del self._pending[stamp_ns]
        return released

    def release(self, stamp_ns: int) -> dict[str, Any] | None:
        """Return what there is of a stamp, if only wanted kinds are missing, and forget it."""
        _, messages = self._pending.get(stamp_ns, (0.0, {}))
        if not messages or not messages.keys() >= self._required:
            return None
        del self._pending[stamp_ns]
        return messages

    def drop(self, stamps_ns: Iterable[int]) -> None:
        """Give stamps up."""
        for stamp_ns in stamps_ns:
            self._pending.pop(stamp_ns, None)

    @property
    def stamps_ns(self) -> tuple[int, ...]:
        """Stamps of which something has come, but not all."""
        return tuple(self._pending)

    def clear(self) -> None:
        """Forget what is incomplete."""
        self._pending.clear()
