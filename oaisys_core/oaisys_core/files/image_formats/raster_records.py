"""Bounds the records in a raster's header: GDAL compares each with all that came before it."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass
from mmap import mmap

from oaisys_core.files.image_formats.image_headers import is_tiff
from oaisys_core.files.image_formats.tiff_directories import tiff_directories

MOST = 4096
"""Records of a file; those of satellites have some hundred."""

_GDAL_METADATA = 42112
"""The tag of a TIFF file with GDAL's items of metadata in XML."""
_MOST_XML_BYTES = 1_000_000

_NETCDF_OFFSET_BYTES = {b"CDF\1": 4, b"CDF\2": 8, b"CDF\5": 8}
"""Length of the places of values, by the first bytes of a netCDF-3 file."""
_VALUE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 4, 6: 8, 7: 1, 8: 2, 9: 4, 10: 8, 11: 8}
"""Length of a value, by the number of its netCDF type."""

_JPEG_2000, _CODESTREAM = b"\0\0\0\x0cjP  ", b"\xff\x4f\xff\x51"
"""First bytes of JPEG 2000 with boxes, and without any."""
_BOXES_OF_BOXES = (b"jp2h", b"asoc", b"res ", b"uinf", b"jumb")
_TILE_PART = 0xFF90
"""Marker in a codestream of JPEG 2000 that ends its main header."""


def check_records(data: bytes | mmap) -> None:
    """Raise if a raster's header has more records than any program writes.

    What is damaged is left to GDAL, which tells it.

    Raises:
        ValueError: It is a TIFF, netCDF-3 or JPEG 2000 file with more than `MOST` records.
    """
    with suppress(struct.error, KeyError):
        if is_tiff(data[:4]):
            _check_items(data)
        elif data[:4] in _NETCDF_OFFSET_BYTES:
            NetcdfHeader(data).check()
        elif data[:8] == _JPEG_2000:
            _check_boxes(data)
        elif data[:4] == _CODESTREAM:
            _check_segments(data, 0)


def _check_items(data: bytes | mmap) -> None:
    for order, word, _, places in tiff_directories(data):
        for at in places:
            (tag,) = struct.unpack_from(order + "H", data, at)
            if tag != _GDAL_METADATA:
                continue
            length, begin = struct.unpack_from(order + word * 2, data, at + 4)
            if length > _MOST_XML_BYTES:
                raise ValueError(
                    f"its GDAL_METADATA has {length} bytes, more than {_MOST_XML_BYTES}"
                )
            if (count := data[begin : begin + length].count(b"<Item")) > MOST:
                raise ValueError(f"its GDAL_METADATA has {count} items, more than {MOST}")


def _check_boxes(data: bytes | mmap) -> None:
    """Raise if a JPEG 2000 file has too many boxes (ISO/IEC 15444-1, annex I), also inner ones."""
    place = boxes = 0
    while place + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, place)
        head = 8
        if length == 1:
            (length,), head = struct.unpack_from(">Q", data, place + 8), 16
        boxes += 1
        if boxes > MOST:
            raise ValueError(f"it has more than {MOST} boxes")
        if kind == b"jp2c":
            _check_segments(data, place + head)
        if length < head:  # 0: it goes on to the end
            return
        place += head if kind in _BOXES_OF_BOXES else length


def _check_segments(data: bytes | mmap, place: int) -> None:
    """Raise if the main header of a codestream (annex A) has too many segments."""
    place += 2
    for _ in range(MOST):
        marker, length = struct.unpack_from(">HH", data, place)
        if marker == _TILE_PART:
            return
        place += 2 + length
    raise ValueError(f"its codestream begins with more than {MOST} segments")


@dataclass
class NetcdfHeader:
    """A netCDF-3 header, which is walked to its end.

    Its form is that of the "NetCDF Classic Format Specification" (Unidata), appendix B.

    Attributes:
        data: The file.
        place: Of what comes next, in bytes.
        records: Dimensions, attributes and variables so far.
    """

    data: bytes | mmap
    place: int = 4
    records: int = 0

    def __post_init__(self) -> None:
        self._count = ">Q" if self.data[3] == 5 else ">I"

    def check(self) -> None:
        """Go to the header's end; raise `ValueError` if there are more than `MOST` records."""
        self._number()  # of the values along the dimension without an end
        for _ in range(self._length_of_list()):
            self._skip_name()
            self._number()
        self._skip_attributes()
        for _ in range(self._length_of_list()):
            self._skip_name()
            dimensions = self._number()
            self.place += dimensions * struct.calcsize(self._count)
            self._skip_attributes()
            self.place += 4  # its type
            self._number()
            self.place += _NETCDF_OFFSET_BYTES[self.data[:4]]

    def _number(self) -> int:
        (found,) = struct.unpack_from(self._count, self.data, self.place)
        self.place += struct.calcsize(self._count)
        return int(found)

    def _length_of_list(self) -> int:
        self.place += 4  # its tag
        length = self._number()
        self.records += length
        if self.records > MOST:
            what = f"{self.records} dimensions, variables and attributes"
            raise ValueError(f"its header has at least {what}, more than {MOST}")
        return length

    def _skip_name(self) -> None:
        length = self._number()
        self.place += _padded(length)

    def _skip_attributes(self) -> None:
        for _ in range(self._length_of_list()):
            self._skip_name()
            (kind,) = struct.unpack_from(">I", self.data, self.place)
            self.place += 4
            length = self._number()
            self.place += _padded(length * _VALUE_BYTES[kind])


def _padded(length: int) -> int:
    return -(-length // 4) * 4
