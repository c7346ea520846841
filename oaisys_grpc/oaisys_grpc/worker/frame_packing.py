"""The arrays of a message between server and worker: where they lie, and how they are found there.

Must not import gRPC.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_grpc.worker.shared_memory import (
    SHARED_FROM_BYTES,
    Segment,
    SegmentWriter,
    layout,
    segment_of,
)

AnyArray = NDArray[Any]

MAX_FILES = 16
"""Of one message; arrays in more than these are copied."""

_INLINE = -1


class Cargo(NamedTuple):
    """Arrays on their way.

    Attributes:
        headers: Of each array its data type and shape, its file's number (-1: inline), and where it
            begins there.
        files: Whose descriptors go along.
        inline: The bytes of what lies in no file.
    """

    headers: list[dict[str, Any]]
    files: list[Segment]
    inline: bytes


def load(arrays: Sequence[AnyArray], writer: SegmentWriter) -> Cargo:
    """Return arrays as they travel; inverse: `unload`.

    Those that lie in shared memory stay there. The others go into a new file if they are large.
    """
    arrays = [np.ascontiguousarray(array) for array in arrays]
    files: list[Segment] = []
    numbers = []
    for array in arrays:
        segment = segment_of(array)
        if segment is not None and segment not in files and len(files) < MAX_FILES - 1:
            files.append(segment)
        numbers.append(files.index(segment) if segment in files else _INLINE)
    loose = [a for a, number in zip(arrays, numbers, strict=True) if number == _INLINE]
    raws = [array.reshape(-1).view(np.uint8) for array in loose]
    inline, where = b"", _INLINE
    if sum(raw.size for raw in raws) >= SHARED_FROM_BYTES:
        descriptor, begins, size = writer.write(raws)
        where = len(files)
        files.append(Segment(descriptor, size))
    else:
        begins, size = layout([raw.size for raw in raws])
        inline = _inline(raws, begins, size)
    spots = iter([(where, begin) for begin in begins])
    headers = []
    for array, number in zip(arrays, numbers, strict=True):
        spot = next(spots) if number == _INLINE else (number, files[number].offset_of(array))
        headers.append(
            {"dtype": array.dtype.str, "shape": array.shape, "file": spot[0], "begin": spot[1]}
        )
    return Cargo(headers, files, inline)


def unload(
    headers: Sequence[dict[str, Any]], files: Sequence[Segment], inline: bytes
) -> list[AnyArray]:
    """Return the arrays of a `Cargo`, which are not copied."""
    return [_array((*files, inline)[header["file"]], header) for header in headers]


def _inline(raws: Sequence[AnyArray], begins: Sequence[int], size: int) -> bytes:
    content = np.zeros(size, dtype=np.uint8)
    for begin, raw in zip(begins, raws, strict=True):
        content[begin : begin + raw.size] = raw
    return content.tobytes()


def _array(memory: Any, header: dict[str, Any]) -> AnyArray:
    shape = tuple(header["shape"])
    count = math.prod(shape)
    if not count:
        return np.empty(shape, header["dtype"])
    array = np.frombuffer(memory, header["dtype"], count, header["begin"])
    return array.reshape(shape)
