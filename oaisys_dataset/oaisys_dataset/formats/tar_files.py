"""Tar files of bounded size, and Parquet files that say what is where in them."""

from __future__ import annotations

import tarfile
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.names import path_inside
from oaisys_dataset.shards import append_file, tar_size

if TYPE_CHECKING:
    import pyarrow as pa

BLOCK = tarfile.BLOCKSIZE
END_BYTES = tarfile.RECORDSIZE
"""Most bytes that a tar file has after its last member."""

MIN_BYTES = END_BYTES + 2 * BLOCK
"""A tar file with one small file."""


class TarFiles:
    """Numbered tar files; a new one begins where a group of files would make one too large."""

    def __init__(self, target: Path, stem: str, most_bytes: int) -> None:
        self._target = target
        self._stem = stem
        self._most_bytes = most_bytes
        self._tar: tarfile.TarFile | None = None
        self._open = ExitStack()
        self.count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def append(
        self, key: str, files: Mapping[str, bytes]
    ) -> tuple[str, dict[str, tuple[int, int]]]:
        """Append a group of files; return its tar file, and where each is and its size."""
        size = sum(BLOCK + tar_size(len(data)) for data in files.values())
        if size + END_BYTES > self._most_bytes:
            expected = f"at least {size + END_BYTES}, which {key} needs"
            raise InvalidInputError("settings.shard_bytes", self._most_bytes, expected)
        tar = self._tar
        if tar is None or tar.offset + size + END_BYTES > self._most_bytes:
            tar = self._begin()
        places = {
            ending: (append_file(tar, path_inside(Path(), f"{key}.{ending}").name, data), len(data))
            for ending, data in files.items()
        }
        return self._name, places

    def _begin(self) -> tarfile.TarFile:
        self._close()
        self._name = f"{self._stem}-{self.count:06d}.tar"
        self.count += 1
        path = path_inside(self._target, self._name)
        tar = tarfile.TarFile(path, "x", format=tarfile.USTAR_FORMAT)
        self._tar = self._open.enter_context(tar)
        return self._tar

    def _close(self) -> None:
        self._open.close()
        self._tar = None


class ParquetRows:
    """A Parquet file that is written row by row."""

    ROWS = 10_000
    """Rows that are written together."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self._path = path
        self._schema = schema
        self._rows: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        from pyarrow.parquet import ParquetWriter

        self._file = ParquetWriter(self._path, self._schema)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._flush()
        self._file.close()

    def append(self, row: dict[str, Any]) -> None:
        """Add a row."""
        self._rows.append(row)
        if len(self._rows) == self.ROWS:
            self._flush()

    def _flush(self) -> None:
        import pyarrow as pa

        self._file.write_table(pa.Table.from_pylist(self._rows, self._schema))
        self._rows.clear()
