"""How many streaming calls there may be at a time: each holds a thread as long as it lasts."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from oaisys_core.errors import QueueFullError
from oaisys_grpc.server.jobs.queue import QUEUE_LIMIT_OF_NEWCOMERS
from oaisys_grpc.server.limits.open_calls import (
    CROWDED_REQUESTS,
    MOST_WAITING,
    OpenCall,
    Slots,
    when_over,
)

LIMITS = {
    "WatchOperation": 64,
    "RenderSample": 48,
    "GetSample": 16,
    "GetGroundTruthMesh": 8,
    "GetHeightField": 8,
    "Watch": 32,
    "GetFrame": 32,
}
"""By the call's name; all stream but GetFrame, whose answer may be as large."""

LIMIT_OF_OTHERS = 8
"""Of all other streams together, such as those of reflection."""

SHARE_OF_CONNECTION = 0.75
"""Of each limit: what one connection may have."""

_RESERVE = 24
"""Threads for calls that answer at once: health, cancelling, asking how things stand."""

THREADS = (
    sum(LIMITS.values())
    + LIMIT_OF_OTHERS
    + MOST_WAITING * (len(LIMITS) + 1)
    + QUEUE_LIMIT_OF_NEWCOMERS
    + 2 * CROWDED_REQUESTS
    + _RESERVE
)
"""Of a server: for each stream, each unary call that waits for the worker, and each call whose
request is still to come."""


class StreamLimits:
    """Refuses streaming calls that are too many, and the threads stay free."""

    def __init__(self) -> None:
        self._slots = {name: _slots(limit) for name, limit in LIMITS.items()}
        self._others = _slots(LIMIT_OF_OTHERS)

    @contextlib.contextmanager
    def slot(self, call: OpenCall) -> Iterator[None]:
        """Hold a place for a call.

        Raises:
            QueueFullError: There is none.
        """
        slots = self._slots.get(call.name, self._others)
        _take(slots, call)
        try:
            yield
        finally:
            slots.release(call)

    def take(self, call: OpenCall, context: Any) -> None:
        """Take a place for a call that answers once, where its kind is limited, until its end.

        Raises:
            QueueFullError: There is none.
        """
        slots = self._slots.get(call.name)
        if slots is not None:
            _take(slots, call)
            when_over(context, lambda: slots.release(call))


def _take(slots: Slots, call: OpenCall) -> None:
    if not slots.take(call):
        raise QueueFullError(f"too many calls of {call.name} at a time; try again later")


def _slots(limit: int) -> Slots:
    return Slots(limit, int(SHARE_OF_CONNECTION * limit))
