"""Where the worker keeps images: in shared memory from the beginning, so that they are copied once.

Must not import gRPC.
"""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakSet

import numpy as np

from oaisys_core.types import Frame
from oaisys_grpc.worker.shared_memory import SHARED_FROM_BYTES, Segment, SegmentWriter

MAX_FILES = 400
"""That images of the cache of views may lie in: each takes two descriptors. Others are copied when
they are sent."""


class FramePlacement:
    """Moves the frames of a sample into shared memory, those that are ready together into one file.

    What sends them or keeps them for the next such view then only passes the file on.
    """

    def __init__(self) -> None:
        self._writer = SegmentWriter()
        self._files: WeakSet[Segment] = WeakSet()
        self._left: list[tuple[Frame, ...]] = []

    def __call__(self, frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
        """Return the frames where they lie from now on; few bytes stay where they are."""
        if sum(frame.data.nbytes for frame in frames) < SHARED_FROM_BYTES:
            return frames
        if len(self._files) >= MAX_FILES:
            return frames
        arrays = [np.ascontiguousarray(frame.data) for frame in frames]
        raws = [array.reshape(-1).view(np.uint8) for array in arrays]
        descriptor, begins, size = self._writer.write(raws)
        file = Segment(descriptor, size)
        self._files.add(file)
        self._left.append(frames)
        placed = []
        for frame, array, begin in zip(frames, arrays, begins, strict=True):
            data = np.frombuffer(file, array.dtype, array.size, begin)
            data.flags.writeable = False  # the cache keeps what nobody can change
            placed.append(replace(frame, data=data.reshape(array.shape)))
        return tuple(placed)

    def prepare(self) -> None:
        """Find memory for the frames that come next.

        It takes the kernel as long as copying an image: call when nobody waits.
        """
        self._writer.prepare()

    def tidy(self) -> None:
        """Give back the memory that all frames so far came from; as `prepare`.

        Not before the sample's end, when it takes just as long but somebody waits: the backend
        holds all of them until then.
        """
        self._left.clear()
