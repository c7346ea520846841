"""A place for objects in a file system of fsspec, such as S3."""

from __future__ import annotations

import io
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

from oaisys_core.errors import RenderError
from oaisys_core.system.ending.leftovers import temporary_folder
from oaisys_dataset.places.reading import require_found

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

PIECE_BYTES = 2**20
"""Bytes of an upload that are given to its thread at a time."""


class RemotePlace:
    """A folder in a file system of fsspec.

    Args:
        url: Its URL.
        files: The file system.
        root: Path of the folder in it.
    """

    def __init__(self, url: str, files: AbstractFileSystem, root: str) -> None:
        self.folder: Path | None = None
        self.url = url
        self._files: Any = files
        self._root = root

    def exists(self, name: str) -> bool:
        """See `StoragePlace.exists`."""
        return bool(self._files.isfile(self._path(name)))

    def names(self, below: str) -> list[str]:
        """See `StoragePlace.names`."""
        folder = self._path(below)
        # Other processes write to the same place.
        self._files.invalidate_cache()
        try:
            entries = self._files.ls(folder, detail=True)
        except (FileNotFoundError, NotADirectoryError):
            return []
        files = [entry["name"] for entry in entries if entry["type"] == "file"]
        return sorted(f"{below}/{name.rpartition('/')[2]}" for name in files)

    def size(self, name: str) -> int:
        """See `StoragePlace.size`."""
        with require_found(self.url, name):
            return int(self._files.size(self._path(name)))

    def read(self, name: str, offset: int = 0, size: int | None = None) -> bytes:
        """See `StoragePlace.read`."""
        # `cat_file` of Arrow's wrapper opens a stream that cannot seek if the range begins at 0.
        with require_found(self.url, name), self._files.open(self._path(name), "rb") as file:
            if offset:
                file.seek(offset)
            if size is not None and size > PIECE_BYTES:
                # A size from a manifest may be anything; `read` would take memory for all of it.
                size = min(size, max(0, self.size(name) - offset))
            return bytes(file.read() if size is None else file.read(size))

    def write(self, name: str, data: bytes) -> None:
        """See `StoragePlace.write`."""
        try:
            self._make_folder(name)
            self._files.pipe_file(self._path(name), data)
        except OSError as error:
            raise RenderError(f"{self.url}/{name}: could not be written: {error}") from error

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """See `StoragePlace.writing`."""
        with temporary_folder("oaisys-upload-") as folder:
            path = folder / name.rpartition("/")[2]
            try:
                yield path
                self._make_folder(name)
                self._files.put_file(str(path), self._path(name))
            except OSError as error:
                raise RenderError(f"{self.url}/{name}: could not be written: {error}") from error

    @contextmanager
    def streaming(self, name: str) -> Iterator[IO[bytes]]:
        """See `StoragePlace.streaming`; a thread uploads while the block goes on."""
        try:
            self._make_folder(name)
            with Upload(self._files.open(self._path(name), "wb")) as upload:
                try:
                    yield cast("IO[bytes]", upload)
                    upload.finish()
                except BaseException:
                    upload.abandon()
                    with suppress(OSError):
                        self.delete(name)
                    raise
        except OSError as error:
            raise RenderError(f"{self.url}/{name}: could not be written: {error}") from error

    def delete(self, name: str) -> None:
        """See `StoragePlace.delete`."""
        with suppress(FileNotFoundError):
            self._files.rm_file(self._path(name))

    def is_empty(self) -> bool:
        """See `StoragePlace.is_empty`."""
        self._files.invalidate_cache()
        try:
            return not self._files.ls(self._root, detail=False)
        except (FileNotFoundError, NotADirectoryError):
            return not self._files.exists(self._root)

    def clear(self) -> None:
        """See `StoragePlace.clear`."""
        with suppress(FileNotFoundError):
            self._files.rm(self._root, recursive=True)

    def delete_parts(self) -> int:
        """Do nothing: an upload that was cut off leaves nothing that can be seen."""
        return 0

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _make_folder(self, name: str) -> None:
        self._files.makedirs(self._path(name).rpartition("/")[0], exist_ok=True)


class Upload(io.RawIOBase):
    """Writes to a file of a file system in a thread of its own, a piece at a time.

    The next piece is collected meanwhile; whoever is faster waits. What goes wrong in the thread is
    raised by a later call, at last by `finish`.
    """

    def __init__(self, file: Any) -> None:
        self._file = file
        self._piece = bytearray()
        self._position = 0
        self._thread = ThreadPoolExecutor(1, "upload")
        self._sending: Future[None] | None = None

    def writable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the number of bytes so far."""
        return self._position

    def write(self, data: Any) -> int:
        """Take bytes, and begin to send them if they are enough."""
        self._piece += data
        self._position += len(data)
        if len(self._piece) >= PIECE_BYTES:
            self._send()
        return len(data)

    def finish(self) -> None:
        """Send what is left, and wait until the object is complete."""
        self._send()
        self._wait()
        self._file.close()

    def abandon(self) -> None:
        """Stop sending; whatever the file system then has of the object has to be deleted."""
        self._thread.shutdown(cancel_futures=True)
        with suppress(OSError, ValueError):
            self._file.close()

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown()
        super().close()

    def _send(self) -> None:
        self._wait()
        piece, self._piece = self._piece, bytearray()
        self._sending = self._thread.submit(self._send_piece, piece)

    def _send_piece(self, piece: bytearray) -> None:
        self._file.write(piece)

    def _wait(self) -> None:
        if self._sending is not None:
            self._sending.result()
