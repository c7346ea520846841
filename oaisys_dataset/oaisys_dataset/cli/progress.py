"""Progress of ``oaisys dataset render``: a bar on a terminal, otherwise lines on standard error."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

import typer

from oaisys_core.system.progress_display import ProgressDisplay

if TYPE_CHECKING:
    from oaisys_dataset.rendering.dataset_rendering import DatasetSummary


class DatasetProgress(ProgressDisplay):
    """Shows worlds, views, frames per hour and the time left; use it in a ``with`` block.

    Args:
        summary: What it shows; changed by others.
        views_per_world: Number of views of each world.
    """

    def __init__(self, summary: DatasetSummary, views_per_world: int) -> None:
        self._summary = summary
        self._views_per_world = views_per_world
        self._total = summary.planned * views_per_world
        self._kept = summary.kept * views_per_world
        self._began_s = time.monotonic()
        super().__init__(
            "starting", self._total, self._kept, print_line=partial(typer.echo, err=True)
        )
        self.postpone_line()

    def update(self) -> None:
        """Show the summary as it is now."""
        done = self._summary.views_done(self._views_per_world)
        self.count(done)
        summary, elapsed_s = self._summary, time.monotonic() - self._began_s
        text = f"{summary.kept + summary.finished} of {summary.planned} worlds"
        if summary.failures:
            text += f", {len(summary.failures)} failed"
        if not summary.frames:
            text += f", the first view takes {elapsed_s:.0f} s so far"
            left = ""
        else:
            text += f", {summary.frames / elapsed_s * 3600:.0f} frames/h"
            seconds_left = elapsed_s / (done - self._kept) * (self._total - done)
            left = f", {duration(seconds_left)} left"
        self.describe(text)
        self.print_if_due(f"{done} of {self._total} views, {text}{left}")


def duration(seconds: float) -> str:
    """Return a duration in words, such as ``2 h 05 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
