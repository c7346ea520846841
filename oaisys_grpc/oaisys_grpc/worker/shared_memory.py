"""Shared memory for processes of one user on one machine: sealed memfds (Linux).

The worker writes frames into such a file, the server passes it on, and a client on the same machine
maps it; nobody copies it. A sealed file neither changes nor shrinks, so whoever maps it need not
trust its writer. It has no name and ends with its last user. Must not import gRPC.
"""

from __future__ import annotations

import fcntl
import hmac
import mmap
import os
import secrets
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

AnyArray = NDArray[Any]

AVAILABLE = sys.platform == "linux" and hasattr(os, "memfd_create")
TOKEN_BYTES = 32
"""Random bytes at the beginning of each file; a process that knows them can read the file."""

SHARED_FROM_BYTES = 64 * 1024
"""Fewer bytes are sent within their message."""

_ALIGNMENT = 64
NAME = "oaisys"
_SEALS = ("F_SEAL_SEAL", "F_SEAL_SHRINK", "F_SEAL_GROW", "F_SEAL_WRITE")


class Place(NamedTuple):
    """Where an array lies in a file that another process can open."""

    process_id: int
    descriptor: int
    file_size: int
    token: bytes
    offset: int = 0


class Segment(mmap.mmap):
    """A sealed file mapped into this process; arrays that view it keep it open.

    It is mapped copy-on-write: what this process writes into it others do not see.
    """

    descriptor: int

    def __new__(cls, descriptor: int, size: int) -> Self:
        """Map a file, and take its descriptor over."""
        try:
            self = super().__new__(cls, descriptor, size, access=mmap.ACCESS_COPY)
        except BaseException:
            os.close(descriptor)
            raise
        self.descriptor = descriptor
        return self

    def __del__(self) -> None:
        os.close(self.descriptor)

    def offset_of(self, array: AnyArray) -> int:
        """Return how many bytes from the beginning an array of it lies."""
        return _address(array) - _address(np.frombuffer(self, np.uint8))

    def place(self, offset: int) -> Place:
        """Return where others find what is ``offset`` bytes from the beginning."""
        return Place(os.getpid(), self.descriptor, len(self), self[:TOKEN_BYTES], offset)


def copied_to_segment(arrays: Sequence[AnyArray]) -> list[AnyArray]:
    """Copy arrays into one new segment and return them as they lie there; nobody can change them.

    Raises:
        OSError: There is no memory left.
    """
    arrays = [np.ascontiguousarray(array) for array in arrays]
    begins, size = _layout([array.nbytes for array in arrays])
    descriptor = os.memfd_create(NAME, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.ftruncate(descriptor, size)
        _write(descriptor, np.frombuffer(secrets.token_bytes(TOKEN_BYTES), np.uint8), 0)
        for begin, array in zip(begins, arrays, strict=True):
            _write(descriptor, array.reshape(-1).view(np.uint8), begin)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, all_seals())
    except BaseException:
        os.close(descriptor)
        raise
    segment = Segment(descriptor, size)
    copies = []
    for begin, array in zip(begins, arrays, strict=True):
        copy = np.frombuffer(segment, array.dtype, array.size, begin).reshape(array.shape)
        copy.flags.writeable = False
        copies.append(copy)
    return copies


class Probe:
    """A small file by which a client proves that it can read this process's memory."""

    def __init__(self) -> None:
        (array,) = copied_to_segment([np.zeros(1, np.uint8)])
        segment = segment_of(array)
        assert segment is not None
        self._segment = segment

    @property
    def place(self) -> Place:
        """Where the file is, without the token in it."""
        return self._segment.place(0)._replace(token=b"")

    def proves(self, token: bytes) -> bool:
        """Return whether this is the token in the file."""
        return hmac.compare_digest(token, self._segment[:TOKEN_BYTES])


def _layout(sizes: Sequence[int]) -> tuple[list[int], int]:
    """Return where arrays of so many bytes begin behind the token, aligned, and where all end."""
    begins = []
    end = TOKEN_BYTES
    for size in sizes:
        end += -end % _ALIGNMENT
        begins.append(end)
        end += size
    return begins, end


def place_of(array: AnyArray) -> Place | None:
    """Return where other processes find an array; None where they do not."""
    segment = segment_of(array)
    return None if segment is None else segment.place(segment.offset_of(array))


def segment_of(array: AnyArray) -> Segment | None:
    """Return the segment that a whole array lies in, byte after byte; None where it does not."""
    base: object = array
    while isinstance(base, np.ndarray | memoryview):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    return base if isinstance(base, Segment) and array.flags.c_contiguous else None


def _write(descriptor: int, data: NDArray[np.uint8], offset: int) -> None:
    """Write all of the data; one call writes 2 GB at most."""
    rest = data.data
    while rest:
        count = os.pwrite(descriptor, rest, offset)
        rest, offset = rest[count:], offset + count


def all_seals() -> int:
    """Return what keeps a file as it is: its bytes, its size, and this very promise."""
    seals = 0
    for name in _SEALS:
        seals |= int(getattr(fcntl, name))
    return seals


def _address(array: AnyArray) -> int:
    address: int = array.__array_interface__["data"][0]
    return address
