"""Pages of Parquet files that unpack to more than the file says are refused before they do."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_dataset.objects import SCHEMA, decode_objects
from oaisys_dataset.parquet_pages import check_pages

BOMB_BYTES = 48 << 20
ROWS = 3


def table(text: str) -> pa.Table:
    """Return a few rows that are all alike; no world has them."""

    def repeat(kind: pa.DataType, count: int) -> pa.Array:
        if pa.types.is_fixed_size_list(kind):
            inner = repeat(kind.value_type, count * kind.list_size)
            return pa.FixedSizeListArray.from_arrays(inner, kind.list_size)
        value = pa.scalar(text if pa.types.is_string(kind) else 0, kind)
        return pa.repeat(value, count)

    return pa.Table.from_arrays([repeat(field.type, ROWS) for field in SCHEMA], schema=SCHEMA)


def file_of(rows: pa.Table, **options: Any) -> bytes:
    file = io.BytesIO()
    pq.write_table(rows, file, **options)
    return file.getvalue()


def varint(number: int, length: int) -> bytes:
    """Encode a number as Thrift's compact protocol does, in that many bytes."""
    parts = [(2 * number >> 7 * index) & 127 for index in range(length)]
    return bytes([*(part | 128 for part in parts[:-1]), parts[-1]])


@pytest.fixture
def pool() -> Iterator[pa.MemoryPool]:
    """The pool that pyarrow allocates from meanwhile."""
    before = pa.default_memory_pool()
    counting = pa.proxy_memory_pool(before)
    pa.set_memory_pool(counting)
    yield counting
    pa.set_memory_pool(before)


def test_a_footer_that_lies_about_its_pages_is_refused(pool: pa.MemoryPool) -> None:
    rows = table("a").set_column(0, "frame_id", pa.array(["a" * BOMB_BYTES] + ["a"] * (ROWS - 1)))
    honest = file_of(rows, compression="zstd", use_dictionary=False)
    metadata = pq.ParquetFile(pa.BufferReader(honest)).metadata
    group, size = metadata.row_group(0), metadata.row_group(0).column(0).total_uncompressed_size
    lying = honest
    for number in (size, group.total_byte_size):
        assert lying.count(varint(number, 4)) >= 1
        lying = lying.replace(varint(number, 4), varint(number % 1000, 4))
    assert len(lying) == len(honest) < BOMB_BYTES / 100
    claimed = pq.ParquetFile(pa.BufferReader(lying)).metadata.row_group(0)
    assert claimed.column(0).total_uncompressed_size == size % 1000
    used = pool.max_memory()
    with pytest.raises(InvalidInputError, match=r"table: frame_id.*as the file's footer says"):
        decode_objects(lying, "table")
    assert pool.max_memory() - used < BOMB_BYTES / 10


@pytest.mark.parametrize("encoding", ["DELTA_BYTE_ARRAY", "DELTA_LENGTH_BYTE_ARRAY"])
def test_encodings_that_repeat_what_came_before_are_refused(encoding: str) -> None:
    file = file_of(table("a"), use_dictionary=False, column_encoding={"frame_id": encoding})
    with pytest.raises(InvalidInputError, match="frame_id: received 'a data page of encoding"):
        decode_objects(file, "table")


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("use_dictionary", [True, False])
@pytest.mark.parametrize("codec", ["none", "snappy", "gzip", "lz4", "zstd"])
def test_what_pyarrow_writes_passes(codec: str, use_dictionary: bool, version: str) -> None:
    file = file_of(
        table("a" * 64),
        compression=codec,
        use_dictionary=use_dictionary,
        data_page_version=version,
        write_page_index=True,
        row_group_size=2,
    )
    check_pages(file, pq.ParquetFile(pa.BufferReader(file)).metadata, "table")


def test_damaged_headers_of_pages_are_refused_in_a_sentence() -> None:
    file = file_of(table("a" * 64), compression="zstd")
    metadata = pq.ParquetFile(pa.BufferReader(file)).metadata
    begin = metadata.row_group(0).column(0).dictionary_page_offset
    for damage in (b"\xff" * 40, b"\x1c" * 40, b"\x19\xf5" + b"\xff" * 38, b"\x18" + b"\x7f" * 39):
        damaged = file[:begin] + damage + file[begin + 40 :]
        with pytest.raises(InvalidInputError, match="table: frame_id: received"):
            check_pages(damaged, metadata, "table")
