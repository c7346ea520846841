"""Progress of a command: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeRemainingColumn,
)

LINE_EVERY_S = 5.0
_PACE_FROM_S = 600.0
"""The time left is estimated from the pace of so many last seconds."""


class ProgressDisplay:
    """Shows the current step of a command and how much is done; use it in a ``with`` block.

    On a terminal that is a bar with the time left, or one changing line if nothing is counted.
    Elsewhere, the first step is printed, and then a step at most every few seconds.
    """

    def __init__(
        self,
        step: str,
        total: int | None = None,
        done: int = 0,
        *,
        is_counted: bool = True,
        console: Console | None = None,
        print_line: Callable[[str], object] | None = None,
        every_s: float = LINE_EVERY_S,
    ) -> None:
        """Prepare the display.

        Args:
            step: The first step.
            total: Number of items, such as views; None: not known yet.
            done: Number of items that are finished already.
            is_counted: Whether items are counted at all.
            console: Console for the bar; None: standard error.
            print_line: Prints a plain line; None: nothing is printed without a terminal.
            every_s: Least time between two plain lines.
        """
        console = console or Console(stderr=True, highlight=False)
        self._is_bar = console.is_terminal
        text = TextColumn("{task.description}", markup=False)
        counts = (
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
        )
        self._bar = Progress(
            *((text, *counts) if is_counted else (SpinnerColumn(), text)),
            console=console,
            disable=not self._is_bar,
            transient=not is_counted,
            speed_estimate_period=_PACE_FROM_S,
        )
        self._task = self._bar.add_task(step, total=total, completed=done)
        self._print_line = print_line
        self._every_s = every_s
        self._printed_s: float | None = None

    def __enter__(self) -> Self:
        """Start the display."""
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the display."""
        self.stop()

    def stop(self) -> None:
        """Stop the display; lines can then be printed."""
        self._bar.stop()

    def show(self, step: str) -> None:
        """Show the current step, also as a plain line."""
        self.describe(step)
        self.print_if_due(step)

    def describe(self, step: str) -> None:
        """Show the current step on a terminal."""
        self._bar.update(self._task, description=step)

    def print_if_due(self, line: str) -> None:
        """Print a plain line, unless a bar is shown or the last line is not old enough."""
        if self._print_line is None or self._is_bar or self._seconds_to_line() > 0:
            return
        self.postpone_line()
        self._print_line(line)

    def count(self, done: int, total: int | None = None) -> None:
        """Show the number of finished items, and of all if that has become known."""
        self._bar.update(self._task, completed=done, total=total)

    def advance(self) -> None:
        """Count a finished item."""
        self._bar.advance(self._task)

    def postpone_line(self) -> None:
        """Print no plain line during the next seconds."""
        self._printed_s = time.monotonic()

    def _seconds_to_line(self) -> float:
        if self._printed_s is None:
            return 0.0
        return self._printed_s + self._every_s - time.monotonic()


@contextmanager
def show_stages(
    what: str, print_line: Callable[[str], object], console: Console | None = None
) -> Iterator[Callable[[str], None]]:
    """Show the stages of a computation; yields what is called with each.

    Args:
        what: The computation, such as ``measuring``.
        print_line: Prints a plain line.
        console: The terminal, if it is one; None: standard error.
    """
    with ProgressDisplay(what, is_counted=False, console=console, print_line=print_line) as display:
        yield lambda step: display.show(f"{what}: {step}")
