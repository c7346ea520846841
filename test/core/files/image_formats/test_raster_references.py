"""Rasters whose reference system cannot be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import ELEVATION
from oaisys_core.files.image_formats.rasters import open_raster


@pytest.mark.parametrize("mark", [b",1:*oEprj_Size,", b",1:*oEprj_Coordinate,lower"])
def test_a_broken_reference_system_is_refused_in_a_sentence(tmp_path: Path, mark: bytes) -> None:
    """A byte changed in the map information of an Erdas Imagine file: GDAL's system is no WKT."""
    file = tmp_path / "model.img"
    heights = np.arange(256, dtype=np.float32).reshape(16, 16)
    place = from_origin(500_000, 5_000_000, 2, 2)
    options = {"driver": "HFA", "dtype": "float32", "crs": "EPSG:32632", "transform": place}
    with rasterio.open(file, "w", width=16, height=16, count=1, **options) as writer:
        writer.write(heights, 1)
    data = file.read_bytes()
    assert mark in data
    file.write_bytes(data.replace(mark, mark.replace(b":", b";")))
    with (
        pytest.raises(InvalidInputError, match=r"model\.img.*expected an elevation model"),
        open_raster(file, ELEVATION) as raster,
    ):
        raster.crs.to_wkt()
