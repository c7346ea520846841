"""A place for objects in a folder of this machine."""

from __future__ import annotations

import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from oaisys_core.errors import RenderError
from oaisys_core.files.documents import open_regular
from oaisys_core.system.ending.leftovers import remove_when_killed
from oaisys_dataset.places.reading import require_found

PART = ".part"
"""End of the names of files that are being written; they begin with a dot."""

MAX_FILE_BYTES = 2**62
"""More than any file has; what is read of it is bounded by who reads."""

MAX_WHOLE_BYTES = 1 << 29
"""Size of an object that is read as a whole: a manifest of 200,000 frames, a head, a table."""


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
        with require_found(self.url, name):
            return (self._root / name).stat().st_size

    def read(self, name: str, offset: int = 0, size: int | None = None) -> bytes:
        """See `StoragePlace.read`."""
        path = self._root / name
        most_bytes = MAX_WHOLE_BYTES if size is None else MAX_FILE_BYTES
        with require_found(self.url, name), open_regular(path, most_bytes) as file:
            # A size from a manifest may be anything; `read` would take memory for all of it.
            left = max(0, os.fstat(file.fileno()).st_size - offset)
            file.seek(offset)
            return file.read(left if size is None else min(size, left))

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
        with remove_when_killed(part):
            try:
                self._require_own_folder(target.parent)
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

    def _require_own_folder(self, folder: Path) -> None:
        """Raise `OSError` where a link in a place of somebody else leads out of the place."""
        for each in (folder, *folder.parents):
            if each == self._root:
                return
            if each.is_symlink():
                raise OSError(f"{each.name} is a link")

    @contextmanager
    def streaming(self, name: str) -> Iterator[IO[bytes]]:
        """See `StoragePlace.streaming`."""
        with self.writing(name) as path, path.open("wb") as file:
            yield file

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
        found = [*self._root.glob(f".*{PART}"), *self._root.glob(f"*/.*{PART}")]
        # Folders of this name are of other commands, which may be alive.
        parts = [part for part in found if part.is_symlink() or not part.is_dir()]
        for part in parts:
            part.unlink(missing_ok=True)
        return len(parts)
