"""Progress of long computations: reported to a callback, displayed on a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.console import Console

ProgressCallback = Callable[[str], None]
"""Called with the current step, such as ``view 3 of 30``."""

LINE_INTERVAL_S = 5.0
"""Least time between two plain lines."""


def ignore_progress(step: str) -> None:
    """Ignore a step."""


class ProgressDisplay:
    """Shows steps on standard error: as one changing line on a terminal, else as plain lines.

    Use it in a ``with`` block and call it with each step. Without a terminal, a line is printed for
    the first step and then at most every `LINE_INTERVAL_S`.
    """

    def __init__(
        self,
        what: str,
        print_line: Callable[[str], None] | None = None,
        console: Console | None = None,
    ) -> None:
        """Prepare the display.

        Args:
            what: The task, such as ``measuring``.
            print_line: Prints a plain line; None: on the console.
            console: The console; None: standard error.
        """
        from rich.console import Console
        from rich.status import Status

        self._what = what
        self._console = console or Console(stderr=True, highlight=False)
        self._print_line = print_line or self._print
        self._status = Status(what, console=self._console)
        self._printed_s: float | None = None

    def __enter__(self) -> Self:
        """Start the display."""
        if self._console.is_terminal:
            self._status.start()
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Remove the changing line."""
        self._status.stop()

    def __call__(self, step: str) -> None:
        """Show a step."""
        text = f"{self._what}: {step}"
        if self._console.is_terminal:
            self._status.update(text)
            return
        now_s = time.monotonic()
        if self._printed_s is None or now_s - self._printed_s >= LINE_INTERVAL_S:
            self._printed_s = now_s
            self._print_line(text)

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, soft_wrap=True)
