"""Opens rasters with GDAL: by named drivers, from memory, without files beside them or network."""

from __future__ import annotations

import re
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import ceil
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import LONGEST_QUOTE, InvalidInputError
from oaisys_core.files.image_formats.image_use import BYTES_PER_PIXEL, ImageUse
from oaisys_core.files.image_formats.images import check_pictures, read_file
from oaisys_core.files.image_formats.raster_records import check_records
from oaisys_core.private.gdal_messages import GdalMessages, gdal_messages

MAX_BANDS = 64
"""Bands of a raster."""

GEOTIFF = ("GTiff",)

CACHE_BYTES = 64_000_000
"""Decoded blocks of a large file that GDAL keeps."""

ELEVATION_DRIVERS = (
    *GEOTIFF,
    *("AAIGrid", "GRASSASCIIGrid", "SRTMHGT", "DTED", "USGSDEM", "HFA", "netCDF", "ISIS3", "PDS"),
    *("VICAR", "GSAG", "GSBG", "GS7BG", "BT", "SIGDEM", "HF2", "Terragen", "Leveller", "NWT_GRD"),
    *("GXF", "ISG", "GTX", "BYN", "ZMap", "XYZ", "KRO", "ELAS", "RMF", "JP2OpenJPEG", "GRIB"),
    "NITF",
)
"""GDAL's drivers of formats in which an elevation model is one file that needs no other."""

_NOT_RECOGNIZED = "not recognized as being in a supported file format"
_UNKNOWN_FORMAT = (
    "it is of no known format, such as GeoTIFF, .asc, .hgt or PNG; docs/files.md, Elevation models,"
    " lists all, and writes an array as a GeoTIFF"
)

_HGT_NAME = re.compile(r"[NS]\d{2}[EW]\d{3}", re.IGNORECASE)
"""Beginning of the name of an SRTM tile, which says where it is."""

_LABEL_BYTES = 1_000_000
_POINTER = re.compile(rb"\^\s*(?!DATA_SET_MAP_PROJECTION|DESCRIPTION)\w+\s*=\s*([^\r\n]*)")
"""Says where pixels are; the two others name documents, which nobody reads."""
_LABEL_END = re.compile(rb"^[ \t]*end[\s\0]", re.IGNORECASE | re.MULTILINE)
_PLACE_IN_FILE = re.compile(rb"\d+\s*(<BYTES>)?\s*(/\*.*)?")

# In memory GDAL finds no neighbours, and the file's name, such as GTIFF_DIR:…, means nothing.
_IN_MEMORY = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
    "GDAL_PAM_ENABLED": "NO",
    "GTIFF_REPORT_COMPD_CS": "YES",
    "CPL_VSIL_CURL_ALLOWED_EXTENSIONS": ".none",
    "PROJ_NETWORK": "OFF",
    # What fails in a thread of GDAL's own is printed, and no error of the call.
    "GDAL_NUM_THREADS": "1",
}

# Where a file lies, worldfiles may lie beside it. With this option GDAL (3.10) delivers memory that
# nobody has written as the place of a JPEG 2000 file that has none.
_ALONE = {**_IN_MEMORY, "GDAL_GEOREF_SOURCES": "INTERNAL"}

_WARNING_IS_DAMAGE = ("DTED", "JP2OpenJPEG")
"""Drivers that decode what they can of damaged pixels, and only warn of the others."""

_opening = threading.Lock()


@contextmanager
def without_georeference() -> Iterator[None]:
    """Let images be opened that are no maps, without a warning, by one thread at a time.

    Filters of warnings belong to all threads.
    """
    from rasterio.errors import NotGeoreferencedWarning

    with _opening, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


@contextmanager
def open_geotiff(source: Path | bytes, use: ImageUse, name: str | None = None) -> Iterator[Any]:
    """Open a GeoTIFF by itself: no other format, no files beside it, no network.

    Args:
        source: The file, or its bytes.
        use: Bounds its size.
        name: Of the file in errors; None: its path.

    Yields:
        The dataset of rasterio.

    Raises:
        InvalidInputError: It is too large, or no GeoTIFF that can be read.
    """
    with open_raster(source, use, name, GEOTIFF) as file:
        yield file


@contextmanager
def open_raster(
    source: Path | bytes,
    use: ImageUse,
    name: str | None = None,
    drivers: Sequence[str] = ELEVATION_DRIVERS,
) -> Iterator[Any]:
    """Open a raster by itself, see `open_geotiff`, in the format of one of some drivers.

    Raises:
        InvalidInputError: It is too large, refers to other files, cannot be read, or GDAL says of
            pixels that were read that they are damaged.
    """
    from rasterio import Env
    from rasterio.io import MemoryFile

    data = read_file(source, use) if isinstance(source, Path) else source
    shown = name or str(source)
    if not data:  # which rasterio would take for a file to write
        raise use.refusal(shown, ValueError("it is empty"))
    _check_alone(data, use, shown)
    _check_header(data, use, shown)
    if use.is_of_numbers:  # of pictures, whoever decodes them tells
        check_pictures(data, use, shown)
    with (
        _refuse_errors(use, shown, is_any_format=drivers is ELEVATION_DRIVERS),
        Env(**_IN_MEMORY),
        MemoryFile(data, filename=_name_in_memory(shown)) as memory,
        memory.open(driver=list(drivers)) as file,
    ):
        _check_size(file, use, shown)
        with _refuse_damage(file, use, shown):
            yield file


@contextmanager
def open_large_geotiff(path: Path, use: ImageUse) -> Iterator[Any]:
    """Open a GeoTIFF where it lies, to read windows of it, see `open_geotiff`.

    Args:
        path: The file, of any number of pixels.
        use: Bounds its blocks, which are decoded as a whole.

    Raises:
        InvalidInputError: It is no GeoTIFF that can be read.
    """
    import rasterio

    if not path.is_file():
        raise use.refusal(str(path), FileNotFoundError("no regular file"))
    if path.stat().st_size:
        with path.open("rb") as opened, mmap(opened.fileno(), 0, access=ACCESS_READ) as data:
            _check_header(data, use, str(path))
    with (
        _refuse_errors(use, str(path)),
        rasterio.Env(**_ALONE, GDAL_CACHEMAX=CACHE_BYTES),
        rasterio.open(path.resolve(), driver="GTiff") as file,
    ):
        _check_blocks(file, use, str(path))
        with _refuse_damage(file, use, str(path)):
            yield file


@contextmanager
def _refuse_errors(use: ImageUse, name: str, *, is_any_format: bool = False) -> Iterator[None]:
    """Let a file be refused where rasterio cannot open or read it."""
    from rasterio.errors import CRSError, RasterioError

    try:
        yield
    # A text of GDAL's may have bytes of the file.
    except (RasterioError, CRSError, OSError, UnicodeDecodeError) as error:
        is_unknown = is_any_format and _NOT_RECOGNIZED in str(error)
        raise use.refusal(name, _UNKNOWN_FORMAT if is_unknown else error) from error


@contextmanager
def _refuse_damage(file: Any, use: ImageUse, name: str) -> Iterator[None]:
    """Refuse a file if GDAL says of its pixels that they are damaged, whatever it delivers."""
    from rasterio.errors import RasterioError

    with gdal_messages() as messages:
        try:
            yield
        except RasterioError as error:
            raise use.refusal(name, _damage(messages, file.driver) or error) from error
    if damage := _damage(messages, file.driver):
        raise use.refusal(name, damage)


def _damage(messages: GdalMessages, driver: str) -> str:
    """Return the first of GDAL's messages that says that pixels are damaged; empty: none does."""
    told = messages.errors
    if driver in _WARNING_IS_DAMAGE:
        told = told + messages.warnings
    return told[0][:LONGEST_QUOTE] if told else ""


def _name_in_memory(name: str) -> str:
    """Return a name with nothing of the file's own but what a driver needs."""
    path = Path(name)
    suffix = path.suffix.lower()
    suffix = suffix if re.fullmatch(r"\.[a-z0-9]{1,8}", suffix) else ""
    tile = _HGT_NAME.match(path.name)
    return f"{tile[0].upper() if tile and suffix == '.hgt' else 'raster'}{suffix}"


def _check_alone(data: bytes, use: ImageUse, name: str) -> None:
    """Raise if a file is of a kind whose pixels may be in other files."""
    convert = "convert it with gdal_translate -of GTiff"
    if _is_hdf5(data):
        expected = f"{use.name} but no HDF5 (netCDF-4), which may refer to other files; {convert}"
        raise InvalidInputError(use.field, name, expected)
    if data.startswith(b"EHFA_HEADER_TAG") and b"ExternalRasterDMS" in data:
        expected = f"{use.name} with its pixels in itself, not in an .ige file; {convert}"
        raise InvalidInputError(use.field, name, expected)
    label = data[:_LABEL_BYTES]
    if not re.match(rb"\s*(?:PDS_VERSION_ID|Object\s*=\s*IsisCube|CCSD|NJPL|ODL)", label):
        return
    if not _LABEL_END.search(label):  # GDAL compares each of its keys with all before it
        expected = f"{use.name} whose label ends within its first {_LABEL_BYTES} bytes"
        raise InvalidInputError(use.field, name, expected)
    pointers = [found[1].strip() for found in _POINTER.finditer(label)]
    if b"COMPRESSED_FILE" in label or not all(map(_PLACE_IN_FILE.fullmatch, pointers)):
        expected = f"{use.name} with its pixels behind its label, not in another file; {convert}"
        raise InvalidInputError(use.field, name, expected)


def _check_header(data: bytes | mmap, use: ImageUse, name: str) -> None:
    """Raise if GDAL would take minutes over a header."""
    try:
        check_records(data)
    except ValueError as error:
        raise use.refusal(name, error) from error


def _is_hdf5(data: bytes) -> bool:
    place = 0
    while place < len(data):
        if data[place : place + 8] == b"\x89HDF\r\n\x1a\n":
            return True
        place = max(512, 2 * place)
    return False


def _check_size(file: Any, use: ImageUse, name: str) -> None:
    if file.count == 0:
        layers = ", ".join(each.rpartition(":")[2] for each in file.subdatasets) or "none"
        expected = f"{use.name} with one layer, not {layers} (extract one with gdal_translate)"
        raise InvalidInputError(use.field, name, expected)
    use.check(file.width, file.height, name)
    _check_blocks(file, use, name)


def _check_blocks(file: Any, use: ImageUse, name: str) -> None:
    if file.count > MAX_BANDS:
        expected = f"{use.name} of at most {MAX_BANDS} bands, not {file.count}"
        raise InvalidInputError(use.field, name, expected)
    if any("complex" in dtype for dtype in file.dtypes):
        raise InvalidInputError(use.field, name, f"{use.name} of real numbers")
    is_mixed = file.interleaving is not None and file.interleaving.value == "PIXEL"
    item_bytes = max(np.dtype(dtype).itemsize for dtype in file.dtypes)
    # A picture in one strip is no more than the picture.
    together = ceil((file.count if is_mixed else 1) * item_bytes / BYTES_PER_PIXEL)
    for rows, columns in file.block_shapes:
        # A block is decoded as a whole, however small the image is.
        use.check(columns, rows * together, name)
