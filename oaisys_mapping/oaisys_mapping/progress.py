"""Progress of long computations."""

from __future__ import annotations

from collections.abc import Callable

ProgressCallback = Callable[[str], None]
"""Called with the current step, such as ``view 3 of 30``."""


def ignore_progress(step: str) -> None:
    """Ignore a step."""
