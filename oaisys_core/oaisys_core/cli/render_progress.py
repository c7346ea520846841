"""Progress of ``oaisys render``: a bar on a terminal, otherwise lines on standard error."""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as ProgressBar

if TYPE_CHECKING:
    from oaisys_core.types import Progress

LINE_EVERY_S = 5.0


class RenderProgress:
    """Shows the progress of a run; use it in a ``with`` block, and call it with each `Progress`.

    Without a terminal, a line is printed after every ``every_s`` without output.

    Attributes:
        is_bar: Whether a bar is shown.
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
        self.is_bar = console.is_terminal
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        self._bar = ProgressBar(*columns, TimeElapsedColumn(), console=console)
        self._task = self._bar.add_task("rendering", total=total, completed=done)
        self._what = "starting"
        self._now = self._what
        self._began_s = self._said_s = time.monotonic()
        self._every_s = every_s
        self._ended = threading.Event()
        self._teller = threading.Thread(target=self._tell, name="progress", daemon=True)

    def __enter__(self) -> Self:
        """Start the display."""
        if self.is_bar:
            self._bar.start()
        else:
            self._teller.start()
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop the display."""
        self._ended.set()
        if self.is_bar:
            self._bar.stop()
        else:
            self._teller.join()

    def begin(self, what: str) -> None:
        """Set the name of the current work, such as ``world 2``."""
        self._what = self._now = what
        self._began_s = time.monotonic()
        self._bar.update(self._task, description=what)

    def __call__(self, progress: Progress) -> None:
        """Show the progress of the current work."""
        self._now = f"{self._what}: {progress.stage}, {progress.fraction:.0%}"
        self._bar.update(self._task, description=self._now)

    def view_done(self) -> None:
        """Count a finished view."""
        self._said_s = time.monotonic()
        self._bar.advance(self._task)

    def _tell(self) -> None:
        while not self._ended.wait(self._every_s / 10):
            now_s = time.monotonic()
            if now_s - self._said_s >= self._every_s:
                self._said_s = now_s
                typer.echo(f"{self._now}, {now_s - self._began_s:.0f} s", err=True)
