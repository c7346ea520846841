"""Places that hold data sets: a folder, or a URL that fsspec knows (``file://``, ``s3://``).

An object of a place is whole or absent: in a folder it gets its name when it is complete, elsewhere
the store shows it when its upload is complete.
"""

from __future__ import annotations

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Protocol

from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_dataset.places.local import MAX_WHOLE_BYTES, PART, LocalPlace
from oaisys_dataset.places.remote import RemotePlace

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

__all__ = [
    "MAX_WHOLE_BYTES",
    "PART",
    "S3_ENDPOINT",
    "LocalPlace",
    "RemotePlace",
    "StoragePlace",
    "open_place",
]

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

    def streaming(self, name: str) -> AbstractContextManager[IO[bytes]]:
        """Yield a file to be written from beginning to end, which becomes the object.

        What is written may be on its way while the block goes on. If the block fails, there may be
        no object afterwards, also where there was one.
        """

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
    if not path.strip("/"):
        raise InvalidInputError("place", url, f"{scheme}://PLACE/FOLDER")
    if scheme in ("file", "local"):
        return LocalPlace(Path(path))
    try:
        files, root = _s3(path) if scheme == "s3" else _any(url)
    except ImportError as error:
        raise ConfigError(f"{url}: {error}; `oaisys_dataset[all]` has what it needs") from error
    except (ValueError, OSError) as error:
        expected = f"a path, or a URL that fsspec can open ({error})"
        raise InvalidInputError("place", url, expected) from error
    return RemotePlace(url.rstrip("/"), files, root.rstrip("/"))


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
