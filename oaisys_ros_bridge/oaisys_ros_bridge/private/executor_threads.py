"""The threads of a ``MultiThreadedExecutor``, for whose end rclpy does not wait.

Private part: ``_executor`` of rclpy's ``MultiThreadedExecutor``, its pool of threads.
Tried with: rclpy 7.1.6.
Public way without it: ``Executor.shutdown`` with a timeout, which returns at once in rclpy 7.1.
Lost without it: a silent end; callbacks under way may find their publishers destroyed.
"""

from __future__ import annotations

import threading
import warnings
from functools import partial
from typing import Any

from oaisys_core.system.fallbacks import report_fallback

POOL = "_executor"
"""Attribute of an executor."""

DROPPED = r"coroutine 'Executor\._make_handler"
"""How Python begins to warn of a callback that was dropped before it began."""


def wait_for_threads(executor: Any, timeout_s: float) -> bool:
    """Return whether all callbacks under way have ended within ``timeout_s``.

    Callbacks that wait for a thread are dropped: they would find the executor's handles
    destroyed ("cannot use Destroyable").
    """
    warnings.filterwarnings("ignore", DROPPED, RuntimeWarning)
    pool = getattr(executor, POOL, None)
    if pool is None:
        instead = "callbacks that still run at a node's end may write errors"
        report_fallback("rclpy's threads", f"an executor has no {POOL}", instead)
        return bool(executor.shutdown(timeout_s))
    end = partial(pool.shutdown, wait=True, cancel_futures=True)
    waiter = threading.Thread(target=end, name="executor's end", daemon=True)
    waiter.start()
    waiter.join(timeout_s)
    return not waiter.is_alive()
