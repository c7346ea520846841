"""Progress of ``oaisys dataset render``: a bar on a terminal, otherwise lines on standard error."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as ProgressBar

if TYPE_CHECKING:
    from oaisys_dataset.rendering import DatasetSummary

LINE_EVERY_S = 5.0


class DatasetProgress:
    """Shows worlds, views, frames per hour and the time left; use it in a ``with`` block."""

    def __init__(
        self,
        summary: DatasetSummary,
        views_per_world: int,
        console: Console,
        every_s: float = LINE_EVERY_S,
    ) -> None:
        """Prepare the display.

        Args:
            summary: What it shows; changed by others.
            views_per_world: Number of views of each world.
            console: Console for the bar.
            every_s: Least time between two lines, if there is no bar.
        """
        self._summary = summary
        self._views_per_world = views_per_world
        self._is_bar = console.is_terminal
        columns = (BarColumn(), MofNCompleteColumn(), TextColumn("views, {task.description}"))
        self._bar = ProgressBar(*columns, console=console)
        total = summary.planned * views_per_world
        done = summary.kept * views_per_world
        self._task = self._bar.add_task("starting", total=total, completed=done)
        self._every_s = every_s
        self._began_s = self._said_s = time.monotonic()

    def __enter__(self) -> Self:
        """Start the display."""
        if self._is_bar:
            self._bar.start()
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop the display."""
        self.stop()

    def stop(self) -> None:
        """Stop the display; lines can then be printed."""
        if self._is_bar:
            self._bar.stop()

    def update(self) -> None:
        """Show the summary as it is now."""
        text = self.described()
        self._bar.update(self._task, completed=self._views_done(), description=text)
        now_s = time.monotonic()
        if not self._is_bar and now_s - self._said_s >= self._every_s:
            self._said_s = now_s
            total = self._summary.planned * self._views_per_world
            typer.echo(f"{self._views_done()} of {total} views, {text}", err=True)

    def described(self) -> str:
        """Return the worlds that are finished, the frames per hour and the time left."""
        summary, elapsed_s = self._summary, time.monotonic() - self._began_s
        worlds = f"{summary.kept + summary.finished} of {summary.planned} worlds"
        if summary.failures:
            worlds += f", {len(summary.failures)} failed"
        if not summary.frames:
            return f"{worlds}, the first view takes {elapsed_s:.0f} s so far"
        total = summary.planned * self._views_per_world
        now, before = self._views_done(), summary.kept * self._views_per_world
        seconds_left = elapsed_s / (now - before) * (total - now)
        rate = summary.frames / elapsed_s * 3600
        return f"{worlds}, {rate:.0f} frames/h, {duration(seconds_left)} left"

    def _views_done(self) -> int:
        return self._summary.views_done(self._views_per_world)


def duration(seconds: float) -> str:
    """Return a duration in words, such as ``2 h 05 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
