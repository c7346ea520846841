"""Depth and labels are computed by a thread while Cycles renders colour and leaves a core idle."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Self

from oaisys_core.backend.base import FrameGroup
from oaisys_core.types import Frame

CORES = len(os.sched_getaffinity(0))
"""Processors that this process may use."""


class BackgroundGeometry:
    """Frames that a thread computes beside the caller's work; a context manager.

    The end of the block waits for the thread.

    Attributes:
        group: The frames; its result raises whatever computing them raised.
    """

    def __init__(self, compute: Callable[[], tuple[Frame, ...]]) -> None:
        """Start the thread; ``compute`` runs in a copy of the caller's context."""
        self._compute = compute
        self._busy_s: float | None = None
        self._executor = ThreadPoolExecutor(1, "geometry")
        future = self._executor.submit(copy_context().run, self._run)
        self.group = FrameGroup(future.result, future.done)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()

    def cost_s(self, seconds: float) -> float:
        """Return by how much it lengthened work that took all cores for ``seconds``."""
        # Threads share the cores alike.
        most_s = seconds / (CORES + 1)
        return most_s if self._busy_s is None else min(self._busy_s / CORES, most_s)

    def _run(self) -> tuple[Frame, ...]:
        frames = self._compute()
        self._busy_s = time.thread_time()
        return frames
