"""Depth and labels in a thread beside Cycles: the one leaves a core idle that the other can use."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from threading import Lock

from oaisys_core.backend.base import FramesCallback, ProgressCallback
from oaisys_core.types import Frame, Progress

CORES = len(os.sched_getaffinity(0))
"""Processors that this process may use."""


class Aside:
    """What is computed aside while the thread that began it, Blender's, renders colour."""

    def __init__(
        self,
        executor: Executor,
        compute: Callable[[], tuple[Frame, ...]],
        on_frames: FramesCallback,
    ) -> None:
        """Begin; see `computed_aside`."""
        self._compute = compute
        self._on_frames = on_frames
        self._told = Lock()
        self._busy_s: float | None = None
        # Which files may be read is a matter of the caller's context.
        self._computed = executor.submit(copy_context().run, self._work)

    def tell(self, progress: ProgressCallback, how_far: Progress) -> None:
        """Call a callback, though not while frames are handed on."""
        with self._told:
            progress(how_far)

    def cost_s(self, seconds: float) -> float:
        """Return by how much it has lengthened work that took all cores for so many seconds."""
        # Threads share the cores alike.
        most_s = seconds / (CORES + 1)
        return most_s if self._busy_s is None else min(self._busy_s / CORES, most_s)

    def frames(self) -> tuple[Frame, ...]:
        """Return the frames once they are handed on.

        Raises:
            Exception: Whatever computing them or handing them on raised.
        """
        return self._computed.result()

    def _work(self) -> tuple[Frame, ...]:
        frames = self._compute()
        self._busy_s = time.thread_time()
        if frames:
            with self._told:
                self._on_frames(frames)
        return frames


@contextmanager
def computed_aside(
    compute: Callable[[], tuple[Frame, ...]], on_frames: FramesCallback
) -> Iterator[Aside]:
    """Have frames computed, and handed on where there are any, in a thread that ends here.

    It waits for the thread however the block ends: nothing is handed on after that.
    """
    with ThreadPoolExecutor(1, "geometry") as executor:
        yield Aside(executor, compute, on_frames)
