"""Waiting for events, with deadlines, and how long tests may wait."""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any

PATIENCE_S = 60.0
"""For what should take a second: a busy machine must not fail a test."""

START_PATIENCE_S = 240.0
"""For a server to start, which loads all libraries twice: 70 s were seen on a starved machine."""

LOAD_FACTOR = 5.0
"""What the bounds of docs/reliability.md are multiplied with: the machine does other work, too."""

SHUTDOWN_S = 5.0
"""The bound of row 20 of docs/reliability.md: everything is down."""


def wait_until(
    condition: Callable[[], Any],
    patience_s: float = PATIENCE_S,
    *,
    process: subprocess.Popen[Any] | None = None,
    explain: Callable[[], object] = lambda: "",
    pause: Callable[[], object] = lambda: time.sleep(0.01),
) -> Any:
    """Return what a condition returns as soon as that is true.

    Fails after ``patience_s``, or when ``process`` has ended before, with what ``explain`` returns.
    ``pause`` is called between two looks at the condition.
    """
    end_s = time.monotonic() + patience_s
    while True:
        has_ended = process is not None and process.poll() is not None
        if value := condition():
            return value
        assert not has_ended, f"the process has ended: {explain()}"
        assert time.monotonic() < end_s, f"waited in vain: {explain()}"
        pause()


@contextlib.contextmanager
def within(bound_s: float) -> Iterator[None]:
    """Fail where what is inside takes longer than a documented bound times `LOAD_FACTOR`."""
    began_s = time.monotonic()
    yield
    took_s = time.monotonic() - began_s
    assert took_s <= LOAD_FACTOR * bound_s, f"{took_s:.1f} s, the bound is {bound_s:g} s"
