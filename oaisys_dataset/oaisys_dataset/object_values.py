"""What a table of objects that somebody else wrote may contain, and how much of it is read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry.poses import ROTATION_TOLERANCE
from oaisys_core.output.record_types import Label, Sha256
from oaisys_dataset.parquet_pages import check_pages

MAX_BYTES = 1 << 30
"""Largest table of one world that is read, unpacked; a row has some 800 bytes."""

MAX_TEXT = 4096
"""Longest text of a row, in bytes."""

_LINE = "a text of at most 1000 letters in a line, without control characters"

BATCH_ROWS = 4096

NULLABLE = frozenset({"truncation"})
POSES = ("T_map_object", "T_camera_object")
NOT_NEGATIVE = ("size_m", "diameter_m", "distance_m")
MAX_NUMBER = 1e12
"""Largest number of pixels or metres: products of two of them are finite, and fit into 64 bits."""


def read_rows(file: bytes, name: str, schema: pa.Schema) -> pa.Table:
    """Return the table of a Parquet file's bytes; its columns are those of a schema.

    Texts are unpacked after their lengths are known, and rows in batches: a file of 10 KB may
    announce that it is small and unfold to gigabytes.

    Raises:
        InvalidInputError: It has other columns, or too much in them.
        pyarrow.ArrowException, OSError: It is no Parquet file.
    """
    texts = [field.name for field in schema if pa.types.is_string(field.type)]
    opened = pq.ParquetFile(pa.BufferReader(file))
    if not opened.schema_arrow.equals(schema):
        expected = f"the columns {', '.join(schema.names)}"
        raise InvalidInputError(name, ", ".join(opened.schema_arrow.names), expected)
    _check_size(opened.metadata, len(file), name)
    check_pages(file, opened.metadata, name)
    packed = pq.ParquetFile(pa.BufferReader(file), read_dictionary=texts)
    batches, size = [], 0
    for batch in packed.iter_batches(BATCH_ROWS):
        for text in texts:
            _check_texts(batch.column(text), f"{name}: {text}")
        unpacked = batch.cast(schema)
        size += unpacked.nbytes
        if size > MAX_BYTES:
            raise _too_large(name, size)
        batches.append(unpacked)
    table = pa.Table.from_batches(batches, schema)
    return table.replace_schema_metadata(opened.schema_arrow.metadata)


def _check_size(metadata: Any, length: int, name: str) -> None:
    """Raise if a file announces too much, packed or unpacked."""
    groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    numbers = sum(
        group.column(index).num_values for group in groups for index in range(group.num_columns)
    )
    announced = [
        group.column(index).total_uncompressed_size
        for group in groups
        for index in range(group.num_columns)
    ]
    size = max(sum(announced), sum(group.total_byte_size for group in groups), length, 8 * numbers)
    if size > MAX_BYTES:
        raise _too_large(name, size)


def _too_large(name: str, size: int) -> InvalidInputError:
    return InvalidInputError(name, f"{size} bytes", f"at most {MAX_BYTES} bytes of rows")


def _check_texts(column: Any, field: str) -> None:
    """Raise if a text among those of a column is too long."""
    longest = pc.max(pc.binary_length(column.dictionary)).as_py() or 0
    if longest > MAX_TEXT:
        raise InvalidInputError(field, f"{longest} bytes", f"texts of at most {MAX_TEXT} bytes")


def check_values(table: pa.Table, name: str) -> None:
    """Raise at the first row that no world can have.

    Args:
        table: With the columns of `oaisys_dataset.objects.SCHEMA`.
        name: What errors call the table.

    Raises:
        InvalidInputError: Says which row and column, the value, and what was expected.
    """
    if not table.num_rows:
        return
    for column in table.schema.names:
        for bad, expected in _faults(table[column].combine_chunks(), column):
            if bad.any():
                row = int(np.argmax(bad))
                value = table[column][row].as_py()
                raise InvalidInputError(f"{name}: row {row}: {column}", value, expected)


def _faults(column: Any, name: str) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Yield which rows of a column have a fault, and what they should have."""
    count = len(column)
    if name not in NULLABLE:
        yield _has_null(column), "a value"
    if pa.types.is_string(column.type):
        kind, expected = (
            (_SHA256, "a hash of 64 digits") if name == "mesh_sha256" else (_LABEL, _LINE)
        )
        yield _misfits(column, kind), expected
        return
    values = _numbers(column).reshape(count, -1)
    yield ~(np.abs(values) <= MAX_NUMBER).all(axis=1), f"numbers of at most {MAX_NUMBER:g}"
    if name in POSES:
        yield ~_is_rigid(values.reshape(count, 4, 4)), "a rotation and a translation"
    elif name == "scale":
        yield values[:, 0] <= 0, "a number above 0"
    elif name.startswith("box_") and name.endswith("_px"):
        yield (values[:, 2:] < 0).any(axis=1), "a width and a height of at least 0"
    elif name.endswith("_px") or name in NOT_NEGATIVE:
        yield (values < 0).any(axis=1), "numbers of at least 0"


def _has_null(column: Any) -> NDArray[np.bool_]:
    """Return (N,) whether a row, or a number in its list, is missing."""
    count = len(column)
    missing = np.asarray(pc.is_null(column))
    while pa.types.is_fixed_size_list(column.type):
        column = column.values
        missing = missing | np.asarray(pc.is_null(column)).reshape(count, -1).any(axis=1)
    return np.asarray(missing)


def _numbers(column: Any) -> NDArray[np.float64]:
    """Return all numbers of a column; null is 0."""
    while pa.types.is_fixed_size_list(column.type):
        column = column.values
    return np.asarray(pc.fill_null(column, 0).to_numpy(zero_copy_only=False), np.float64)


def _misfits(column: Any, kind: TypeAdapter[str]) -> NDArray[np.bool_]:
    """Return (N,) whether the text of a row is not of a kind; each text is looked at once."""
    packed = pc.fill_null(column, "").dictionary_encode()
    is_bad = np.array([not _is_of(kind, text) for text in packed.dictionary.to_pylist()], bool)
    return is_bad[packed.indices.to_numpy(zero_copy_only=False)] if len(is_bad) else is_bad


def _is_of(kind: TypeAdapter[str], text: str) -> bool:
    try:
        kind.validate_python(text)
    except ValidationError:
        return False
    return True


def _is_rigid(poses: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (N,) whether (N, 4, 4) matrices are rotations with translations."""
    rotations = poses[:, :3, :3]
    product = rotations @ rotations.transpose(0, 2, 1)
    is_orthonormal = np.abs(product - np.eye(3)).max(axis=(1, 2)) <= ROTATION_TOLERANCE
    is_last_row = (poses[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    return np.asarray(is_orthonormal & is_last_row & (np.linalg.det(rotations) > 0))


_LABEL: TypeAdapter[str] = TypeAdapter(Label)
_SHA256: TypeAdapter[str] = TypeAdapter(Sha256)
