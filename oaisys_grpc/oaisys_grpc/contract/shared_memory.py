"""Shared memory for processes of one user on one machine: sealed memfds (Linux).

The worker writes frames into such a file, the server passes it on, and a client on the same machine
maps it; nobody copies it. A sealed file neither changes nor shrinks, so whoever maps it need not
trust its writer. It has no name and ends with its last user. Must not import gRPC.
"""

from __future__ import annotations

import fcntl
import hmac
import logging
import mmap
import os
import secrets
import stat
import sys
import threading
from collections.abc import Sequence
from typing import NamedTuple, Self
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from oaisys_grpc.contract.arrays import AnyArray

_LOG = logging.getLogger(__name__)

AVAILABLE = sys.platform == "linux" and hasattr(os, "memfd_create")
TOKEN_BYTES = 32
"""Random bytes at the beginning of each file; a process that knows them can read the file."""

SHARED_FROM_BYTES = 64 * 1024
"""Fewer bytes are sent within their message."""

_ALIGNMENT = 64
_NAME = "oaisys"
_SEALS = ("F_SEAL_SEAL", "F_SEAL_SHRINK", "F_SEAL_GROW", "F_SEAL_WRITE")

MAX_MAPPED_FILES = 32
MAX_MAPPED_BYTES = 256 << 20
"""That one `Reader` maps at a time."""


class SharedMemoryError(OSError):
    """The shared memory that was offered is not here, or is something else."""


class MemoryLocation(NamedTuple):
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

    def location(self, offset: int) -> MemoryLocation:
        """Return where others find what is ``offset`` bytes from the beginning."""
        return MemoryLocation(os.getpid(), self.descriptor, len(self), self[:TOKEN_BYTES], offset)


def copy_to_segment(arrays: Sequence[AnyArray]) -> list[AnyArray]:
    """Copy arrays into one new segment and return them as they lie there; nobody can change them.

    Raises:
        OSError: There is no memory left.
    """
    arrays = [np.ascontiguousarray(array) for array in arrays]
    begins, size = _layout([array.nbytes for array in arrays])
    descriptor = os.memfd_create(_NAME, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        os.fchmod(descriptor, 0o600)
        os.ftruncate(descriptor, size)
        _write(descriptor, np.frombuffer(secrets.token_bytes(TOKEN_BYTES), np.uint8), 0)
        for begin, array in zip(begins, arrays, strict=True):
            _write(descriptor, array.reshape(-1).view(np.uint8), begin)
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _all_seals())
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


def share_if_possible(arrays: Sequence[AnyArray]) -> list[AnyArray] | None:
    """Return arrays in one new segment; None if there can be none now: they go another way then."""
    try:
        return copy_to_segment(arrays)
    except OSError as error:
        _LOG.warning("images are not shared, but copied: %s", error)
        return None


class Probe:
    """A small file by which a client proves that it can read this process's memory."""

    def __init__(self) -> None:
        (array,) = copy_to_segment([np.zeros(1, np.uint8)])
        segment = segment_of(array)
        assert segment is not None
        self._segment = segment

    @classmethod
    def if_possible(cls) -> Self | None:
        """Return a new one; None if there can be none: nothing is shared then."""
        try:
            return cls()
        except OSError as error:
            _LOG.warning("images are not shared, but copied: %s", error)
            return None

    @property
    def location(self) -> MemoryLocation:
        """Where the file is, without the token in it."""
        return self._segment.location(0)._replace(token=b"")

    def proves(self, token: bytes) -> bool:
        """Return whether this is the token in the file."""
        return hmac.compare_digest(token, self._segment[:TOKEN_BYTES])


def location_of(array: AnyArray) -> MemoryLocation | None:
    """Return where other processes find an array; None where they do not."""
    segment = segment_of(array)
    return None if segment is None else segment.location(segment.offset_of(array))


def segment_of(array: AnyArray) -> Segment | None:
    """Return the segment that a whole array lies in, byte after byte; None where it does not."""
    base: object = array
    while isinstance(base, np.ndarray | memoryview):
        base = base.base if isinstance(base, np.ndarray) else base.obj
    return base if isinstance(base, Segment) and array.flags.c_contiguous else None


class Reader:
    """Reads arrays in other processes' segments, without copying them if it can; for any thread.

    A mapped segment takes its memory and descriptors as long as one of its arrays lives. So the
    mapped ones are bounded in number and size, and arrays in others are copied.
    """

    def __init__(
        self, max_files: int = MAX_MAPPED_FILES, max_bytes: int = MAX_MAPPED_BYTES
    ) -> None:
        self._max_files = max_files
        self._max_bytes = max_bytes
        self._mapped: WeakSet[Segment] = WeakSet()
        self._lock = threading.Lock()

    def read(
        self, location: MemoryLocation, size: int, files: dict[bytes, Segment]
    ) -> NDArray[np.uint8]:
        """Return ``size`` bytes, which the caller may change.

        Args:
            files: Segments of the same sample, by token; a new one is added.

        Raises:
            SharedMemoryError: The bytes are not there.
        """
        if location.offset + size > location.file_size or len(location.token) != TOKEN_BYTES:
            raise SharedMemoryError(
                f"{size} bytes at {location.offset} are not in the shared memory"
            )
        segment = files.get(location.token)
        if segment is None:
            descriptor = open_location(location)
            with self._lock:
                if not self._has_room(location.file_size):
                    return _copy(descriptor, location.offset, size)
                segment = files[location.token] = _map(descriptor, location.file_size)
                self._mapped.add(segment)
        return np.frombuffer(segment, np.uint8, size, location.offset)

    def _has_room(self, size: int) -> bool:
        taken = [len(segment) for segment in self._mapped]
        return len(taken) < self._max_files and sum(taken) + size <= self._max_bytes


def open_location(location: MemoryLocation) -> int:
    """Return a descriptor of another process's segment; the caller closes it.

    Before it is opened, it is checked to be a segment, because opening anything else, such as a
    pipe, could disturb its owner. An empty token is not compared.

    Raises:
        SharedMemoryError: The location holds no such segment.
    """
    if not AVAILABLE:
        raise SharedMemoryError(f"{sys.platform} has no such shared memory")
    try:
        path = f"/proc/{location.process_id:d}/fd/{location.descriptor:d}"
        handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
        try:
            _check_file(handle, location)
            own = f"/proc/self/fd/{handle}"
            descriptor = os.open(own, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        finally:
            os.close(handle)
        try:
            _check_content(descriptor, location)
        except BaseException:
            os.close(descriptor)
            raise
    except SharedMemoryError:
        raise
    except OSError as error:
        raise SharedMemoryError(f"cannot open shared memory: {error}") from error
    return descriptor


def find_token(location: MemoryLocation) -> bytes:
    """Return the token of a probe, which proves that this process can read the other's memory.

    Raises:
        SharedMemoryError: This process cannot.
    """
    descriptor = open_location(location)
    try:
        return os.pread(descriptor, TOKEN_BYTES, 0)
    finally:
        os.close(descriptor)


def _layout(sizes: Sequence[int]) -> tuple[list[int], int]:
    """Return where arrays of so many bytes begin behind the token, aligned, and where all end."""
    begins = []
    end = TOKEN_BYTES
    for size in sizes:
        end += -end % _ALIGNMENT
        begins.append(end)
        end += size
    return begins, end


def _write(descriptor: int, data: NDArray[np.uint8], offset: int) -> None:
    """Write all of the data; one call writes 2 GB at most."""
    rest = data.data
    while rest:
        count = os.pwrite(descriptor, rest, offset)
        rest, offset = rest[count:], offset + count


def _map(descriptor: int, size: int) -> Segment:
    try:
        return Segment(descriptor, size)
    except (OSError, ValueError) as error:
        raise SharedMemoryError(f"cannot map shared memory: {error}") from error


def _copy(descriptor: int, offset: int, size: int) -> NDArray[np.uint8]:
    content = np.empty(size, np.uint8)
    rest = content.data
    try:
        while rest:
            count = os.preadv(descriptor, [rest], offset)
            if not count:
                raise SharedMemoryError("the shared memory ends too early")
            rest, offset = rest[count:], offset + count
    finally:
        os.close(descriptor)
    return content


def _check_file(handle: int, location: MemoryLocation) -> None:
    status = os.fstat(handle)
    name = os.readlink(f"/proc/self/fd/{handle}")  # noqa: PTH115 - on every sample's way
    if not stat.S_ISREG(status.st_mode) or not name.startswith(f"/memfd:{_NAME}"):
        raise SharedMemoryError("what was offered is no shared memory of a simulator")
    if status.st_size != location.file_size or location.file_size < TOKEN_BYTES:
        raise SharedMemoryError(f"{status.st_size} bytes are shared, not {location.file_size}")


def _check_content(descriptor: int, location: MemoryLocation) -> None:
    if fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & _all_seals() != _all_seals():
        raise SharedMemoryError("the shared memory is not sealed: it could change or shrink")
    token = os.pread(descriptor, TOKEN_BYTES, 0)
    if location.token and not hmac.compare_digest(location.token, token):
        raise SharedMemoryError("the shared memory is another one")


def _all_seals() -> int:
    """Return the seals that fix a file's bytes, its size, and the seals themselves."""
    seals = 0
    for name in _SEALS:
        seals |= int(getattr(fcntl, name))
    return seals


def _address(array: AnyArray) -> int:
    address: int = array.__array_interface__["data"][0]
    return address
