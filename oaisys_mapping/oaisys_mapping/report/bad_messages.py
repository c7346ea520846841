"""Messages to a live page that no browser sends: dropped, counted, and told in one line a minute.

viser and websockets write a traceback for each, as often as somebody sends one.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from oaisys_core.errors import quote
from oaisys_core.system.periodic_count import PeriodicCount
from oaisys_mapping.report.browser_messages import fault_of

_LOG = logging.getLogger(__name__)

LOGGERS = ("websockets.server", "asyncio")
MARKS = ("connection handler failed", "_handle_incoming_message")
"""Parts of the lines about a message that cannot be read, or has values that cannot be used."""


class BadMessages(logging.Filter):
    """Keeps the tracebacks of such messages out of the log, from `start` to `stop`.

    Attributes:
        count: How many there were.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self.count = 0
        self._untold = PeriodicCount(now_s)

    def start(self) -> None:
        """Look at what is logged from now on."""
        for name in LOGGERS:
            logging.getLogger(name).addFilter(self)

    def stop(self) -> None:
        """Let everything be logged again, and write what is not told yet."""
        for name in LOGGERS:
            logging.getLogger(name).removeFilter(self)
        self._tell(at_once=True)

    def is_used(self, data: bytes | str) -> bool:
        """Return whether a message is one that the page uses; count it otherwise."""
        if fault := fault_of(data):
            self._add(fault)
        return not fault

    def filter(self, record: logging.LogRecord) -> bool:
        """Count a line about such a message; any other one is logged."""
        text = record.getMessage()
        if not any(mark in text for mark in MARKS):
            return True
        error = record.exc_info[1] if record.exc_info else None
        self._add(quote(f"{type(error).__name__}: {error}"))
        return False

    def _add(self, reason: str) -> None:
        self.count += 1
        self._untold.add(reason)
        self._tell()

    def _tell(self, *, at_once: bool = False) -> None:
        count, reason = self._untold.take(at_once=at_once)
        if count:
            _LOG.warning(
                "messages to the page that cannot be used: %d, the last: %s", count, reason
            )
