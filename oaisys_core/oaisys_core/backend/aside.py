"""Depth and labels in a thread beside Cycles: the one leaves a core idle that the other can use."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from threading import Lock

from oaisys_core.backend.base import FramesCallback, ProgressCallback
from oaisys_core.types import Frame, Progress


class Aside:
    """What is computed aside while the thread that began it, Blender's, renders colour."""

    def __init__(self, computed: Future[tuple[Frame, ...]], told: Lock) -> None:
        """Take the frames to come, and the lock that is held where callbacks are called."""
        self._computed = computed
        self._told = told

    def tell(self, progress: ProgressCallback, how_far: Progress) -> None:
        """Call a callback, though not while frames are handed on."""
        with self._told:
            progress(how_far)

    def frames(self) -> tuple[Frame, ...]:
        """Return the frames once they are handed on.

        Raises:
            Exception: Whatever computing them or handing them on raised.
        """
        return self._computed.result()


@contextmanager
def computed_aside(
    compute: Callable[[], tuple[Frame, ...]], on_frames: FramesCallback
) -> Iterator[Aside]:
    """Have frames computed, and handed on where there are any, in a thread that ends here.

    It waits for the thread however the block ends: nothing is handed on after that.
    """
    told = Lock()

    def work() -> tuple[Frame, ...]:
        frames = compute()
        if frames:
            with told:
                on_frames(frames)
        return frames

    with ThreadPoolExecutor(1, "geometry") as pool:
        # Which files may be read is a matter of the caller's context.
        yield Aside(pool.submit(copy_context().run, work), told)
