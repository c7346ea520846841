"""Rasters of which GDAL says that they are damaged."""

from __future__ import annotations

import resource
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import from_origin

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import ELEVATION
from oaisys_core.files.image_formats.rasters import open_raster, without_georeference

PLACE = {"crs": "EPSG:32633", "transform": from_origin(412_000, 5_322_000, 2, 2)}
REFUSAL = r"expected an elevation model that can be read \("
SIDE_PX = 9999
"""Of an image within the bound of pixels."""

MOST_MORE_KB = 500_000


def written(path: Path, driver: str, **options: Any) -> bytes:
    values = (np.arange(64 * 64).reshape(64, 64) % 50).astype(np.uint16)
    shape = {"width": 64, "height": 64, "count": 1, "dtype": "uint16"}
    with rasterio.open(path, "w", driver=driver, **shape, **PLACE, **options) as file:
        file.write(values, 1)
    return path.read_bytes()


def read(data: bytes, name: str) -> float:
    with open_raster(data, ELEVATION, name) as file:
        return float(file.read(1).mean())


def test_jpeg_2000_with_fewer_tiles_than_it_says_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """GDAL delivered nothing but zeros, 10,000 columns of them."""
    data = bytearray(written(tmp_path / "model.jp2", "JP2OpenJPEG"))
    assert read(bytes(data), "model.jp2") > 0
    box, size = data.find(b"ihdr"), data.find(b"\xff\x51")
    data[box + 4 : box + 12] = data[size + 6 : size + 14] = struct.pack(">II", SIDE_PX, SIDE_PX)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InvalidInputError, match=REFUSAL + "Failed to decode all used components"):
        read(bytes(data), "model.jp2")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < MOST_MORE_KB
    assert "ERROR" not in capfd.readouterr().err


@pytest.mark.parametrize("kept", [0.66, 0.9, 0.999])
def test_jpeg_2000_that_is_cut_is_refused(kept: float, tmp_path: Path) -> None:
    data = written(tmp_path / "model.jp2", "JP2OpenJPEG", QUALITY=100, REVERSIBLE="YES")
    with pytest.raises(InvalidInputError, match=REFUSAL):
        read(data[: int(kept * len(data))], "model.jp2")


def test_dted_whose_columns_are_damaged_is_refused(tmp_path: Path) -> None:
    """GDAL warns of each of them, and delivers heights of thousands of metres below the sea."""
    side_px = 1201
    half = 0.5 / (side_px - 1)
    place = from_origin(9 - half, 47 + half, 2 * half, 2 * half)
    shape = {"width": side_px, "height": side_px, "count": 1, "dtype": "int16"}
    path = tmp_path / "n46.dt1"
    with rasterio.open(path, "w", driver="DTED", crs="EPSG:4326", transform=place, **shape) as file:
        file.write(np.full((side_px, side_px), 500, np.int16), 1)
    data = bytearray(path.read_bytes())
    assert read(bytes(data), path.name) == 500
    first = len(data) // 3
    data[first : 2 * first] = bytes(first)
    with pytest.raises(InvalidInputError, match=REFUSAL + "Longitude count"):
        read(bytes(data), path.name)


def test_jpeg_2000_without_a_place_has_none(tmp_path: Path) -> None:
    """GDAL delivered memory that nobody had written as its place."""
    path = tmp_path / "model.jp2"
    shape = {"width": 64, "height": 64, "count": 1, "dtype": "uint16"}
    with (
        pytest.warns(NotGeoreferencedWarning),
        rasterio.open(path, "w", driver="JP2OpenJPEG", **shape) as file,
    ):
        file.write(np.full((64, 64), 7, np.uint16), 1)
    with without_georeference(), open_raster(path.read_bytes(), ELEVATION, path.name) as found:
        assert found.transform.is_identity
        assert found.crs is None


def test_a_tiff_whose_strips_are_nowhere_is_refused(tmp_path: Path) -> None:
    """GDAL signals an error about their offsets, and delivers zeros."""
    data = bytearray(written(tmp_path / "model.tif", "GTiff", BLOCKYSIZE=8))
    offsets = struct.pack("<HH", 273, 4)
    entry = data.find(offsets)
    assert entry > 0
    data[entry + 8 : entry + 12] = struct.pack("<I", 2**31)
    with pytest.raises(InvalidInputError, match=REFUSAL):
        read(bytes(data), "model.tif")
