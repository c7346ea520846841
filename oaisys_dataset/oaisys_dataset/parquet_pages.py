"""The pages of a Parquet file as their headers say, checked before any of them is unpacked.

pyarrow allocates what the header of a page says, up to 2 GiB, whatever the file's footer says.
Layout: ``PageHeader`` of Apache Parquet's ``parquet.thrift``, in Thrift's compact protocol.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from oaisys_core.errors import InvalidInputError

CODECS = ("UNCOMPRESSED", "SNAPPY", "GZIP", "LZ4", "ZSTD")

ENCODINGS = {0: "PLAIN", 2: "PLAIN_DICTIONARY", 3: "RLE", 8: "RLE_DICTIONARY"}
"""Those whose values take no more room than their page; prefixes, for instance, can be repeated."""

_UNPACKED_SIZE, _PACKED_SIZE = 2, 3
_KIND_HEADERS = {5: "data page", 7: "dictionary page", 8: "data page"}
"""Fields of a page's header that hold the header of its kind."""
_ENCODING_FIELDS = {5: 2, 7: 2, 8: 4}
"""Field of the encoding in each of these."""

_STOP, _TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = 0, 1, 2, 3, 7, 8, 9, 10, 12
_INTEGERS = (4, 5, 6)
_MAX_DEPTH = 8
_LONGEST_VARINT = 10


class _DamagedError(Exception):
    """The bytes are no header of a page."""


def check_pages(file: bytes, metadata: Any, name: str) -> None:
    """Raise if the pages of a column unpack to more than the file's footer says.

    Args:
        file: The whole file.
        metadata: Its ``pyarrow.parquet.FileMetaData``, whose sizes are bounded already.
        name: What errors call the file.

    Raises:
        InvalidInputError: Names the column.
    """
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        if not group.num_rows:  # nothing of it is read
            continue
        for index in range(group.num_columns):
            column = group.column(index)
            try:
                _check_column(file, column, f"{name}: {column.path_in_schema}")
            except (_DamagedError, IndexError) as error:
                field = f"{name}: {column.path_in_schema}"
                raise InvalidInputError(field, str(error), "pages of a Parquet file") from error


def _check_column(file: bytes, column: Any, field: str) -> None:
    if column.compression not in CODECS:
        raise InvalidInputError(field, column.compression, f"one of {', '.join(CODECS)}")
    unpacked = 0
    for header in _page_headers(file, column):
        unpacked += header[_UNPACKED_SIZE]
        if unpacked > column.total_uncompressed_size:
            expected = f"{column.total_uncompressed_size} bytes, as the file's footer says"
            raise InvalidInputError(field, f"pages of {unpacked} bytes", expected)
        for kind, encoding in _ENCODING_FIELDS.items():
            if kind in header and header[kind].get(encoding) not in ENCODINGS:
                expected = f"one of {', '.join(ENCODINGS.values())}"
                raise InvalidInputError(
                    field,
                    f"a {_KIND_HEADERS[kind]} of encoding {header[kind].get(encoding)}",
                    expected,
                )


def _page_headers(file: bytes, column: Any) -> Iterator[dict[int, Any]]:
    """Yield the headers of a column's pages."""
    at = column.data_page_offset
    if column.has_dictionary_page and 0 < column.dictionary_page_offset < at:
        at = column.dictionary_page_offset
    end = at + column.total_compressed_size
    if not 0 <= at <= end <= len(file):
        raise _DamagedError(f"pages from byte {at} to {end} of {len(file)}")
    while at < end:
        header, at = _struct(file, at, 0)
        sizes = (header.get(_UNPACKED_SIZE), header.get(_PACKED_SIZE))
        if not all(isinstance(size, int) and size >= 0 for size in sizes):
            raise _DamagedError(f"a page whose sizes are {sizes}")
        yield header
        at += header[_PACKED_SIZE]


def _struct(data: bytes, at: int, depth: int) -> tuple[dict[int, Any], int]:
    """Return the fields of a struct by their ids, and where it ends."""
    if depth > _MAX_DEPTH:
        raise _DamagedError(f"a header with more than {_MAX_DEPTH} levels")
    found: dict[int, Any] = {}
    field = 0
    while (head := data[at]) != _STOP:
        at += 1
        if head >> 4:
            field += head >> 4
        else:
            field, at = _integer(data, at)
        kind = head & 15
        if kind in (_TRUE, _FALSE):
            found[field] = kind == _TRUE
        else:
            found[field], at = _value(data, at, kind, depth)
    return found, at + 1


def _value(data: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    """Return a value and where it ends; None for what no check needs."""
    if kind in _INTEGERS:
        return _integer(data, at)
    if kind == _STRUCT:
        return _struct(data, at, depth + 1)
    if kind in (_LIST, _SET):
        return None, _end_of_list(data, at, depth)
    if kind == _BINARY:
        length, at = _varint(data, at)
        return None, at + length
    if kind in (_BYTE, _DOUBLE):
        return None, at + (1 if kind == _BYTE else 8)
    raise _DamagedError(f"a header with a field of type {kind}")


def _end_of_list(data: bytes, at: int, depth: int) -> int:
    count, kind = data[at] >> 4, data[at] & 15
    at += 1
    if count == 15:
        count, at = _varint(data, at)
    if count > len(data) - at:
        raise _DamagedError(f"a header with a list of {count} values")
    for _ in range(count):
        _, at = _value(data, at, _BYTE if kind in (_TRUE, _FALSE) else kind, depth + 1)
    return at


def _integer(data: bytes, at: int) -> tuple[int, int]:
    """Return a signed number and where it ends."""
    number, at = _varint(data, at)
    return (number >> 1) ^ -(number & 1), at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    number = 0
    for shift in range(0, 7 * _LONGEST_VARINT, 7):
        number |= (data[at] & 127) << shift
        at += 1
        if data[at - 1] < 128:
            return number, at
    raise _DamagedError(f"a number of more than {_LONGEST_VARINT} bytes")
