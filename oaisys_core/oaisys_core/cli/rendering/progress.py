"""Progress of ``oaisys render`` and ``oaisys drive``."""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Self

import typer
from rich.console import Console

from oaisys_core.system.progress_display import LINE_EVERY_S, ProgressDisplay

if TYPE_CHECKING:
    from oaisys_core.types import Progress


class RenderProgress:
    """Shows the progress of a run; use it in a ``with`` block, and call it with each `Progress`.

    Without a terminal, a line is printed after every ``every_s`` without output.
    """

    def __init__(
        self, total: int, done: int, console: Console, every_s: float = LINE_EVERY_S
    ) -> None:
        """Prepare the display.

        Args:
            total: Number of views of the run.
            done: Number of views that are finished already.
            console: Console for the bar.
            every_s: Longest time without a line, if there is no bar.
        """
        echo = partial(typer.echo, err=True)
        self._display = ProgressDisplay(
            "starting", total, done, console=console, print_line=echo, every_s=every_s
        )
        self._display.postpone_line()
        self._what = self._now = "starting"
        self._began_s = time.monotonic()
        self._every_s = every_s
        self._ended = threading.Event()
        self._printer = threading.Thread(target=self._print_lines, name="progress", daemon=True)

    def __enter__(self) -> Self:
        """Start the display."""
        self._display.__enter__()
        self._printer.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the display."""
        self._ended.set()
        self._printer.join()
        self._display.stop()

    def begin(self, what: str) -> None:
        """Set the name of the current work, such as ``world 2``."""
        self._what = what
        self._began_s = time.monotonic()
        self._show(what)

    def __call__(self, progress: Progress) -> None:
        """Show the progress of the current work."""
        self._show(f"{self._what}: {progress.stage}, {progress.fraction:.0%}")

    def view_done(self) -> None:
        """Count a finished view."""
        self._display.postpone_line()
        self._display.advance()

    def _show(self, now: str) -> None:
        self._now = now
        self._display.describe(now)

    def _print_lines(self) -> None:
        while not self._ended.wait(self._every_s / 10):
            elapsed_s = time.monotonic() - self._began_s
            self._display.print_if_due(f"{self._now}, {elapsed_s:.0f} s")
