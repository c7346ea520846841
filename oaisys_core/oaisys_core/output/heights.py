"""Writing and reading height grids as GeoTIFF and NPZ files."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
from rasterio import Affine
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.arrays import load_arrays
from oaisys_core.files.image_formats.image_use import ELEVATION
from oaisys_core.files.image_formats.rasters import open_geotiff
from oaisys_core.output.files import write_bytes
from oaisys_core.types import HeightGrid

SUFFIXES = (".tif", ".tiff", ".npz")
BANDS = ("ground", "surface")
FRAME = "map"

MAX_GRID_BYTES = 2_000_000_000
"""Size of the arrays in a file."""


def write_heights(path: Path, grid: HeightGrid) -> None:
    """Write a grid in the format of the file's suffix; inverse: `read_heights`.

    GeoTIFF: two float32 bands in metres, ``ground`` and ``surface``; row 0 in the north (+y); NaN
    is nodata. Heights are those of the pixel centres; the transform refers to pixel corners. The
    coordinates are x and y of ``map``, without a CRS, because ``map`` is not a place on Earth.

    NPZ: ``ground_m`` and ``surface_m`` (rows, columns), row 0 in the south (-y); ``origin_xy_m``,
    the centre of cell [0, 0]; ``spacing_m``; ``frame``.

    Raises:
        InvalidInputError: The file has another suffix.
        RenderError: It could not be written; there is no partial file.
    """
    if path.suffix == ".npz":
        write_bytes(path, _npz(grid))
    elif path.suffix in SUFFIXES:
        write_bytes(path, _tiff(grid))
    else:
        raise InvalidInputError("out", str(path), f"a file that ends in {', '.join(SUFFIXES)}")


def read_heights(path: Path) -> HeightGrid:
    """Return the grid in a file that `write_heights` wrote."""
    if path.suffix == ".npz":
        found = load_arrays(path, MAX_GRID_BYTES)
        x, y = (float(value) for value in found["origin_xy_m"])
        spacing_m = float(found["spacing_m"])
        return HeightGrid(found["ground_m"], found["surface_m"], (x, y), spacing_m)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with open_geotiff(path, ELEVATION) as file:
            ground_m, surface_m = file.read()[:, ::-1]
            to_map = file.transform
            x, y = to_map.c + to_map.a / 2, to_map.f + to_map.e * (file.height - 0.5)
            return HeightGrid(ground_m, surface_m, (x, y), to_map.a)


def _npz(grid: HeightGrid) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        ground_m=grid.ground_m,
        surface_m=grid.surface_m,
        origin_xy_m=np.array(grid.origin_xy_m),
        spacing_m=np.array(grid.spacing_m),
        frame=np.array(FRAME),
    )
    return buffer.getvalue()


def _tiff(grid: HeightGrid) -> bytes:
    rows, columns = grid.ground_m.shape
    half_m, (x, y) = grid.spacing_m / 2, grid.origin_xy_m
    north_m = y + (rows - 1) * grid.spacing_m + half_m
    profile = {
        "driver": "GTiff",
        "height": rows,
        "width": columns,
        "count": len(BANDS),
        "dtype": "float32",
        "nodata": np.nan,
        "compress": "deflate",
        "predictor": 3,
        "transform": Affine(grid.spacing_m, 0, x - half_m, 0, -grid.spacing_m, north_m),
    }
    # Write to memory first: GDAL reports a full disk on standard error only.
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with memory.open(**profile) as file:
            for band, (name, heights_m) in enumerate(
                zip(BANDS, (grid.ground_m, grid.surface_m), strict=True), start=1
            ):
                file.write(heights_m[::-1], band)
                file.set_band_description(band, name)
                file.set_band_unit(band, "m")
            file.update_tags(FRAME=FRAME, UNITS="metres", HEIGHTS_AT="centres of pixels")
        return bytes(memory.getbuffer())
