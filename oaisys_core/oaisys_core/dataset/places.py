"""Places that hold data sets: a folder, or a URL that fsspec knows (``file://``, ``s3://``).

An object of a place is whole or absent: in a folder it gets its name when it is complete, elsewhere
it is uploaded from a complete file.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from oaisys_core.errors import ConfigError, InvalidInputError, NotFoundError, RenderError

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

PART = ".part"
"""End of the names of files that are being written; they begin with a dot."""

S3_ENDPOINT = "AWS_ENDPOINT_URL"
"""Environment variable with the URL of an S3-compatible server."""


class StoragePlace(Protocol):
    """A place that holds objects under names such as ``shards/world_000012.tar``.

    Writing may raise `RenderError`, for instance if the disk is full; the object is then as it was.
    Reading raises `NotFoundError` for an object that does not exist.

    Attributes:
        url: Path or URL of the place.
        folder: The folder of a place on this machine; None elsewhere.
    """

    url: str
    folder: Path | None

    def exists(self, name: str) -> bool:
        """Return whether there is an object of this name."""

    def names(self, below: str) -> list[str]:
        """Return the sorted names of the objects directly in a folder, such as ``shards``."""

    def size(self, name: str) -> int:
        """Return the size of an object in bytes."""

    def read(self, name: str, offset: int = 0, size: int | None = None) -> bytes:
        """Return the bytes of an object, or ``size`` bytes of it from ``offset``."""

    def write(self, name: str, data: bytes) -> None:
        """Write a whole object."""

    def writing(self, name: str) -> AbstractContextManager[Path]:
        """Yield a file on this machine that becomes the object if the block succeeds."""

    def delete(self, name: str) -> None:
        """Delete an object, if it exists."""

    def is_empty(self) -> bool:
        """Return whether there is nothing at the place."""

    def clear(self) -> None:
        """Delete everything at the place."""

    def delete_parts(self) -> int:
        """Delete what killed processes left half written, and return how many files there were.

        Nothing may be writing to the place.
        """


def open_place(where: str | Path) -> StoragePlace:
    """Return the place at a path or URL; nothing is created.

    An ``s3://`` URL uses the server of the environment variable ``AWS_ENDPOINT_URL``, if it is set.

    Raises:
        InvalidInputError: The URL cannot be used.
        ConfigError: A package is missing that the URL needs.
    """
    url = str(where)
    scheme, separator, path = url.partition("://")
    if not separator:
        return LocalPlace(Path(url))
    if scheme in ("file", "local"):
        return LocalPlace(Path(path))
    try:
        files, root = _s3(path) if scheme == "s3" else _any(url)
    except ImportError as error:
        raise ConfigError(f"{url}: {error}; `oaisys_core[dataset]` has what it needs") from error
    except (ValueError, OSError) as error:
        expected = f"a path, or a URL that fsspec can open ({error})"
        raise InvalidInputError("place", url, expected) from error
    return RemotePlace(url.rstrip("/"), files, root.rstrip("/"))


class LocalPlace:
    """A folder on this machine."""

    def __init__(self, folder: Path) -> None:
        self.folder: Path | None = folder
        self.url = str(folder)
        self._root = folder

    def exists(self, name: str) -> bool:
        """See `StoragePlace.exists`."""
        return (self._root / name).is_file()

    def names(self, below: str) -> list[str]:
        """See `StoragePlace.names`."""
        try:
            entries = list(os.scandir(self._root / below))
        except (FileNotFoundError, NotADirectoryError):
            return []
        kept = [e.name for e in entries if e.is_file() and not e.name.startswith(".")]
        return sorted(f"{below}/{name}" for name in kept)

    def size(self, name: str) -> int:
        """See `StoragePlace.size`."""
        with _found(self.url, name):
            return (self._root / name).stat().st_size

    def read(self, name: str, offset: int = 0, size: int | None = None) -> bytes:
        """See `StoragePlace.read`."""
        with _found(self.url, name), (self._root / name).open("rb") as file:
            file.seek(offset)
            return file.read(-1 if size is None else size)

    def write(self, name: str, data: bytes) -> None:
        """See `StoragePlace.write`."""
        with self.writing(name) as path:
            path.write_bytes(data)

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """See `StoragePlace.writing`."""
        target = self._root / name
        # A unique name: a second process may write the same object after the first seemed lost.
        part = target.with_name(f".{target.name}.{uuid.uuid4().hex}{PART}")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            yield part
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.replace(target)
        except OSError as error:
            text = error.strerror or error
            raise RenderError(f"{target}: could not be written: {text}") from error
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)

    def delete(self, name: str) -> None:
        """See `StoragePlace.delete`."""
        (self._root / name).unlink(missing_ok=True)

    def is_empty(self) -> bool:
        """See `StoragePlace.is_empty`."""
        if not self._root.is_dir():
            return not self._root.exists()
        return not any(self._root.iterdir())

    def clear(self) -> None:
        """See `StoragePlace.clear`."""
        shutil.rmtree(self._root, ignore_errors=True)

    def delete_parts(self) -> int:
        """See `StoragePlace.delete_parts`."""
        parts = [*self._root.glob(f".*{PART}"), *self._root.glob(f"*/.*{PART}")]
        for part in parts:
            part.unlink(missing_ok=True)
        return len(parts)


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
        found = [entry["name"] for entry in entries if entry["type"] == "file"]
        return sorted(f"{below}/{name.rpartition('/')[2]}" for name in found)

    def size(self, name: str) -> int:
        """See `StoragePlace.size`."""
        with _found(self.url, name):
            return int(self._files.size(self._path(name)))

    def read(self, name: str, offset: int = 0, size: int | None = None) -> bytes:
        """See `StoragePlace.read`."""
        # `cat_file` of Arrow's wrapper opens a stream that cannot seek if the range begins at 0.
        with _found(self.url, name), self._files.open(self._path(name), "rb") as file:
            if offset:
                file.seek(offset)
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
        with tempfile.TemporaryDirectory(prefix="oaisys-upload-") as folder:
            path = Path(folder, name.rpartition("/")[2])
            try:
                yield path
                self._make_folder(name)
                self._files.put_file(str(path), self._path(name))
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


@contextmanager
def _found(url: str, name: str) -> Iterator[None]:
    try:
        yield
    except (FileNotFoundError, NotADirectoryError) as error:
        raise NotFoundError(f"{url}/{name}: does not exist") from error
    except OSError as error:
        raise InvalidInputError("file", f"{url}/{name}", f"a readable file ({error})") from error


def _any(url: str) -> tuple[AbstractFileSystem, str]:
    from fsspec.core import url_to_fs

    files, root = url_to_fs(url)
    return files, str(root)


def _s3(path: str) -> tuple[AbstractFileSystem, str]:
    """Return S3 by way of Arrow, because s3fs does not agree with other packages on versions."""
    from fsspec.implementations.arrow import ArrowFSWrapper
    from pyarrow.fs import S3FileSystem

    files = S3FileSystem(endpoint_override=os.environ.get(S3_ENDPOINT))
    return ArrowFSWrapper(files), path
