"""How a server ends even if something in it hangs."""

from __future__ import annotations

import logging
import os
import threading
from concurrent.futures import Future

_LOG = logging.getLogger(__name__)

_LAST_S = 4.8
"""From the request to end until the process exits, whatever still runs in it."""


def exit_at_last(started: Future[None]) -> None:
    """Let the process exit soon, even if a thread does not end."""
    failed = started.done() and started.exception() is not None

    def leave() -> None:
        _LOG.warning("something did not end within %g s; the process exits without it", _LAST_S)
        logging.shutdown()
        os._exit(1 if failed else 0)

    timer = threading.Timer(_LAST_S, leave)
    timer.daemon = True
    timer.start()
