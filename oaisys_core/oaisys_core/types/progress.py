"""The progress of long work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """The progress of an operation.

    Attributes:
        stage: What it is doing, such as ``terrain`` or ``render``.
        fraction: Completed share of the whole operation, 0 to 1.
        seconds_left: Estimated time to its end; None if it is not known.
    """

    stage: str
    fraction: float
    seconds_left: float | None = None


def ignore_progress(progress: Progress) -> None:
    """Do nothing."""


ProgressCallback = Callable[[Progress], None]
"""Called during long work; it may raise `CancelledError` to stop it."""
