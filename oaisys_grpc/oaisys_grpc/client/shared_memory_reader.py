"""Reads arrays in shared memory that another process on this machine offers.

Must not import gRPC.
"""

from __future__ import annotations

import fcntl
import hmac
import os
import stat
import sys
import threading
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from oaisys_grpc.worker.shared_memory import AVAILABLE, NAME, TOKEN_BYTES, Place, Segment, all_seals

MAX_MAPPED_FILES = 32
MAX_MAPPED_BYTES = 256 << 20
"""Mapped at a time."""


class SharedMemoryError(OSError):
    """The shared memory that was offered is not here, or is something else."""


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

    def read(self, place: Place, size: int, files: dict[bytes, Segment]) -> NDArray[np.uint8]:
        """Return ``size`` bytes, which the caller may change.

        Args:
            files: Segments of the same sample, by token; a new one is added.

        Raises:
            SharedMemoryError: The bytes are not there.
        """
        if place.offset + size > place.file_size or len(place.token) != TOKEN_BYTES:
            raise SharedMemoryError(f"{size} bytes at {place.offset} are not in the shared memory")
        segment = files.get(place.token)
        if segment is None:
            descriptor = opened(place)
            with self._lock:
                if not self._has_room(place.file_size):
                    return _copied(descriptor, place.offset, size)
                segment = files[place.token] = _mapped(descriptor, place.file_size)
                self._mapped.add(segment)
        return np.frombuffer(segment, np.uint8, size, place.offset)

    def _has_room(self, size: int) -> bool:
        taken = [len(segment) for segment in self._mapped]
        return len(taken) < self._max_files and sum(taken) + size <= self._max_bytes


def opened(place: Place) -> int:
    """Return a descriptor of another process's segment; the caller closes it.

    It is opened only after it was checked to be a segment: opening something else, such as a pipe,
    could disturb its owner. An empty token is not compared.

    Raises:
        SharedMemoryError: The place holds no such segment.
    """
    if not AVAILABLE:
        raise SharedMemoryError(f"{sys.platform} has no such shared memory")
    try:
        path = f"/proc/{place.process_id:d}/fd/{place.descriptor:d}"
        handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
        try:
            _check_file(handle, place)
            own = f"/proc/self/fd/{handle}"
            descriptor = os.open(own, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        finally:
            os.close(handle)
        try:
            _check_content(descriptor, place)
        except BaseException:
            os.close(descriptor)
            raise
    except SharedMemoryError:
        raise
    except OSError as error:
        raise SharedMemoryError(f"cannot open shared memory: {error}") from error
    return descriptor


def found_token(place: Place) -> bytes:
    """Return the token of a probe, which proves that this process can read the other's memory.

    Raises:
        SharedMemoryError: This process cannot.
    """
    descriptor = opened(place)
    try:
        return os.pread(descriptor, TOKEN_BYTES, 0)
    finally:
        os.close(descriptor)


def _mapped(descriptor: int, size: int) -> Segment:
    try:
        return Segment(descriptor, size)
    except (OSError, ValueError) as error:
        raise SharedMemoryError(f"cannot map shared memory: {error}") from error


def _copied(descriptor: int, offset: int, size: int) -> NDArray[np.uint8]:
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


def _check_file(handle: int, place: Place) -> None:
    status = os.fstat(handle)
    name = os.readlink(f"/proc/self/fd/{handle}")  # noqa: PTH115 - on every sample's way
    if not stat.S_ISREG(status.st_mode) or not name.startswith(f"/memfd:{NAME}"):
        raise SharedMemoryError("what was offered is no shared memory of a simulator")
    if status.st_size != place.file_size or place.file_size < TOKEN_BYTES:
        raise SharedMemoryError(f"{status.st_size} bytes are shared, not {place.file_size}")


def _check_content(descriptor: int, place: Place) -> None:
    if fcntl.fcntl(descriptor, fcntl.F_GET_SEALS) & all_seals() != all_seals():
        raise SharedMemoryError("the shared memory is not sealed: it could change or shrink")
    token = os.pread(descriptor, TOKEN_BYTES, 0)
    if place.token and not hmac.compare_digest(place.token, token):
        raise SharedMemoryError("the shared memory is another one")
