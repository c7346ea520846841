"""Memory that processes of one user on one machine hand to each other: sealed memfds (Linux).

The worker writes a sample into such a file, the server passes it on, a client on the same machine
maps it: nobody copies it. A sealed file neither changes nor shrinks, so that who maps it is safe
from whoever made it; it has no name and ends with its last user, however that one ends.
Must not import gRPC.
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
"""So many random bytes begin each file: who knows them can read it."""

SHARED_FROM_BYTES = 64 * 1024
"""Fewer bytes go along with the message that they belong to."""

_ALIGNMENT = 64
NAME = "oaisys"
_SEALS = ("F_SEAL_SEAL", "F_SEAL_SHRINK", "F_SEAL_GROW", "F_SEAL_WRITE")
_LARGEST_SPARE_BYTES = 16 << 20
_SIZES_REMEMBERED = 64


class Place(NamedTuple):
    """Where an array lies in a file that another process can open."""

    process_id: int
    descriptor: int
    file_size: int
    token: bytes
    offset: int = 0


class Segment(mmap.mmap):
    """A sealed file in this process's memory; arrays that look into it keep it alive, and open.

    What is written into it is this process's own, and changes nothing for others.
    """

    descriptor: int

    def __new__(cls, descriptor: int, size: int) -> Self:
        """Map a file; its descriptor is the segment's from now on."""
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


class SegmentWriter:
    """Writes arrays into new sealed files, one file a call; not safe for threads.

    The kernel takes longer to find memory than to copy an image into it. So it is found in
    advance, in `prepare`, for a file as large as what came last time after one like the last: the
    images of a sample come in parts, and those of the next one in the same.
    """

    def __init__(self) -> None:
        self._spare: _File | None = None
        self._last_bytes = 0
        self._next_bytes: dict[int, int] = {}

    def write(self, raws: Sequence[AnyArray]) -> tuple[int, list[int], int]:
        """Return the descriptor of a file with these bytes, which is the caller's to close.

        Returns:
            The descriptor, where each array begins, and the size of all.
        """
        begins, size = layout([raw.size for raw in raws], TOKEN_BYTES)
        file, self._spare = self._spare or _new_file(), None
        descriptor = file.descriptor
        try:
            if file.size != size:
                os.ftruncate(descriptor, size)
            for begin, raw in zip(begins, raws, strict=True):
                _write(descriptor, raw, begin)
            _seal(descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        self._learn(size)
        return descriptor, begins, size

    def prepare(self) -> None:
        """Find memory for the next file; call when nobody waits."""
        expected_bytes = self._next_bytes.get(self._last_bytes, self._last_bytes)
        if self._spare is None and 0 < expected_bytes <= _LARGEST_SPARE_BYTES:
            file = _new_file()
            try:
                os.posix_fallocate(file.descriptor, 0, expected_bytes)
            except OSError:  # no memory: the next file takes what there is then
                os.close(file.descriptor)
            else:
                self._spare = file._replace(size=expected_bytes)

    def close(self) -> None:
        """Give the memory back."""
        if self._spare is not None:
            os.close(self._spare.descriptor)
            self._spare = None

    def _learn(self, size: int) -> None:
        if len(self._next_bytes) >= _SIZES_REMEMBERED:
            self._next_bytes.clear()
        self._next_bytes[self._last_bytes] = size
        self._last_bytes = size


class Probe:
    """A small file by which a client finds out that it can read this process's memory."""

    def __init__(self) -> None:
        writer = SegmentWriter()
        descriptor, _, size = writer.write([np.zeros(1, np.uint8)])
        self._segment = Segment(descriptor, size)

    @property
    def place(self) -> Place:
        """Where it is; the token in it is not to be told."""
        return self._segment.place(0)._replace(token=b"")

    def proves(self, token: bytes) -> bool:
        """Return whether this is the token that only who reads the file knows."""
        return hmac.compare_digest(token, self._segment[:TOKEN_BYTES])


def layout(sizes: Sequence[int], begin: int = 0) -> tuple[list[int], int]:
    """Return where each of arrays of so many bytes begins, aligned, and where all end."""
    begins = []
    end = begin
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


class _File(NamedTuple):
    """A file that is still to be written and sealed; its token is in it."""

    descriptor: int
    size: int


def _new_file() -> _File:
    descriptor = os.memfd_create(NAME, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        _write(descriptor, secrets.token_bytes(TOKEN_BYTES), 0)
    except BaseException:
        os.close(descriptor)
        raise
    return _File(descriptor, TOKEN_BYTES)


def _write(descriptor: int, data: bytes | AnyArray, offset: int) -> None:
    """Write all of the data; one call writes 2 GB at most."""
    rest = memoryview(data) if isinstance(data, bytes) else data.data
    while rest:
        count = os.pwrite(descriptor, rest, offset)
        rest, offset = rest[count:], offset + count


def _seal(descriptor: int) -> None:
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, all_seals())


def all_seals() -> int:
    """Return what keeps a file as it is: its bytes, its size, and this very promise."""
    seals = 0
    for name in _SEALS:
        seals |= int(getattr(fcntl, name))
    return seals


def _address(array: AnyArray) -> int:
    address: int = array.__array_interface__["data"][0]
    return address
