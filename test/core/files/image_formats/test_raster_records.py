"""Files of many small records: decoders took minutes over a few megabytes of them."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.shutil import copy
from scipy.io import netcdf_file

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_headers import image_size
from oaisys_core.files.image_formats.image_use import ELEVATION
from oaisys_core.files.image_formats.raster_records import MOST, NetcdfHeader, check_records
from oaisys_core.files.image_formats.rasters import open_large_geotiff, open_raster

MANY = MOST + 10
VALUES = np.arange(1.0, 49.0).reshape(6, 8)


def encode(suffix: str) -> bytes:
    """Return a picture of 8 x 6 pixels."""
    done, data = cv2.imencode(suffix, np.zeros((6, 8, 3), np.uint8))
    assert done
    return data.tobytes()


def jpeg(count: int) -> bytes:
    """Return a JPEG with so many segments of a program before those of its picture."""
    data = encode(".jpg")
    return data[:2] + count * b"\xff\xe1\0\4ab" + data[2:]


def png(count: int) -> bytes:
    """Return a PNG with so many texts before its pixels."""
    data, content = encode(".png"), b"tEXta\0b"
    chunk = struct.pack(">I", 3) + content + struct.pack(">I", zlib.crc32(content))
    return data[:33] + count * chunk + data[33:]


def netcdf(attributes: int, variables: int = 1, version: int = 1) -> bytes:
    """Return a netCDF-3 file with so many attributes in all, half of them of its first variable."""
    file = io.BytesIO()
    with netcdf_file(file, "w", version=version) as writer:
        writer.createDimension("y", 6)
        writer.createDimension("x", 8)
        for index in range(variables):
            band = writer.createVariable(f"band{index}", np.float32, ("y", "x"))
            band[:] = VALUES
        for index in range(attributes):
            place = writer if index % 2 else writer.variables["band0"]
            setattr(place, f"attribute_{index}", "odd" * (index % 3))
        writer.flush()
        return file.getvalue()


def geotiff(path: Path, items: int) -> Path:
    """Write a GeoTIFF with so many items of metadata."""
    shape = {"width": 8, "height": 6, "count": 1, "dtype": "uint16"}
    with rasterio.open(path, "w", driver="GTiff", **shape) as writer:
        writer.write(np.zeros((1, 6, 8), np.uint16))
        writer.update_tags(**{f"item_{index}": "x" for index in range(items)})
    return path


def jpeg_2000(folder: Path, *, is_bare: bool = False) -> bytes:
    """Return a JPEG 2000 file, or its codestream alone."""
    stored = geotiff(folder / "stored.tif", 0)
    copy(stored, folder / "copy.jp2", driver="JP2OpenJPEG", QUALITY="100", REVERSIBLE="YES")
    data = (folder / "copy.jp2").read_bytes()
    return data[data.index(b"jp2c") + 4 :] if is_bare else data


@pytest.mark.parametrize("box", [b"\0\0\0\x0cxml <a/>", b"\0\0\0\x08asoc"], ids=["xml", "asoc"])
def test_jpeg_2000_files_of_many_boxes_are_refused(tmp_path: Path, box: bytes) -> None:
    data = jpeg_2000(tmp_path)
    place = data.index(b"jp2c") - 4
    check_records(data[:place] + 100 * box + data[place:])
    with pytest.raises(ValueError, match="boxes"):
        check_records(data[:place] + MANY * box + data[place:])


@pytest.mark.parametrize("is_bare", [False, True])
def test_codestreams_of_many_comments_are_refused(tmp_path: Path, is_bare: bool) -> None:
    data = jpeg_2000(tmp_path, is_bare=is_bare)
    place = data.index(b"\xff\x52")
    comment = b"\xff\x64\0\6\0\1ab"
    check_records(data[:place] + 100 * comment + data[place:])
    many = data[:place] + MANY * comment + data[place:]
    with pytest.raises(InvalidInputError, match="segments"), open_raster(many, ELEVATION):
        pass


@pytest.mark.parametrize("start", [b"PDS_VERSION_ID = PDS3\r\n", b"Object = IsisCube\n"])
def test_labels_without_an_end_are_refused(start: bytes) -> None:
    data = start + b"".join(b"  KEY_%d = 1\r\n" % index for index in range(100_000)) + b"END\r\n"
    with pytest.raises(InvalidInputError, match="label ends within"), open_raster(data, ELEVATION):
        pass


@pytest.mark.parametrize("make", [jpeg, png])
def test_pictures_of_many_records_are_refused_before_they_are_decoded(make: object) -> None:
    assert callable(make)
    assert image_size(make(100)) == (8, 6)
    with pytest.raises(ValueError, match=r"more than 4096 (segments|chunks) before"):
        image_size(make(MANY))


def test_a_jpeg_without_pixels_is_refused() -> None:
    with pytest.raises(ValueError, match="no pixels"):
        image_size(b"\xff\xd8\xff\xe1\0\4ab" + bytes(10))


@pytest.mark.parametrize("version", [1, 2])
def test_netcdf_files_of_many_records_are_refused(version: int) -> None:
    check_records(netcdf(100, 3, version))
    for data in (netcdf(MANY, 1, version), netcdf(0, MANY, version)):
        with pytest.raises(ValueError, match=r"at least \d+ dimensions, variables and attributes"):
            check_records(data)
        with pytest.raises(InvalidInputError, match="at least"), open_raster(data, ELEVATION):
            pass


def test_the_header_of_a_netcdf_file_is_walked_to_its_end() -> None:
    """Its values follow. At whatever length it is cut: GDAL tells what is damaged."""
    data = netcdf(7, 2)
    header = NetcdfHeader(data)
    header.check()
    assert (header.place, header.records) == (data.index(VALUES.astype(">f4").tobytes()), 11)
    for length in range(4, len(data)):
        check_records(data[:length])


def test_geotiffs_of_many_items_are_refused(tmp_path: Path) -> None:
    few, many = geotiff(tmp_path / "few.tif", 100), geotiff(tmp_path / "many.tif", MANY)
    for open_it in (open_raster, open_large_geotiff):
        with open_it(few, ELEVATION) as file:
            assert file.tags()["item_99"] == "x"
        with pytest.raises(InvalidInputError, match=rf"{MANY} items"), open_it(many, ELEVATION):
            pass


def test_an_item_may_not_be_longer_than_a_header(tmp_path: Path) -> None:
    path = tmp_path / "long.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=1, height=1, count=1, dtype="uint8"
    ) as file:
        file.update_tags(long="x" * 2_000_000)
    with pytest.raises(InvalidInputError, match="bytes, more than"), open_raster(path, ELEVATION):
        pass
