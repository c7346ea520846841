"""A file for HDF5, which can neither close nor forget one whose disk is full.

It then writes tracebacks while the file is forgotten, and ends the process at its exit.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class FileThatCloses(io.FileIO):
    """A new file that takes all that it is given, and says afterwards what could not be written.

    After the first failure nothing more is written.
    """

    def __init__(self, path: Path) -> None:
        """Make the file.

        Raises:
            OSError: It cannot be made.
        """
        super().__init__(path, "w+")
        self._path = path
        self._fault: OSError | None = None

    def raise_fault(self) -> None:
        """Raise `OSError`, with the file's name, if something could not be written."""
        if self._fault is not None:
            raise OSError(self._fault.errno, self._fault.strerror, str(self._path))

    @contextmanager
    def _keep_fault(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._fault = self._fault or error

    def write(self, data: Any) -> int:
        """Write bytes, and return how many they are."""
        left = memoryview(data).cast("B")
        size = len(left)
        with self._keep_fault():
            while left and self._fault is None:
                left = left[super().write(left) :]
        return size

    def truncate(self, size: int | None = None) -> int:
        """Give the file a size, by default that up to here, and return it."""
        wanted = self.tell() if size is None else size
        with self._keep_fault():
            if self._fault is None:
                super().truncate(wanted)
        return wanted

    def close(self) -> None:
        """Close the file."""
        with self._keep_fault():
            super().close()
