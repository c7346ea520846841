"""TIFF files of pixels, which `images` imports on first use: GDAL costs a second of every start."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rasterio.errors import RasterioError
from rasterio.io import MemoryFile

from oaisys_core.errors import RenderError
from oaisys_core.files.image_formats.image_use import FRAME
from oaisys_core.files.image_formats.rasters import open_geotiff, without_georeference

NO_PREDICTOR, FLOATING_POINT = 1, 3
"""Numbers of predictors in TIFF files."""


def encode_floats(data: NDArray[Any]) -> bytes:
    """Return the TIFF file of (H, W) or (H, W, channels) float32 pixels; inverse: `decode`.

    Equal pixels give equal bytes.

    Raises:
        RenderError: They cannot be encoded.
    """
    # Neighbours often have the same vector, such as the normal of a triangle, which predicted
    # differences would hide from the compression. A single channel is smooth instead.
    predictor = FLOATING_POINT if data.ndim == 2 else NO_PREDICTOR
    # One strip: vectors repeat over many rows.
    whole = {"blockysize": data.shape[0]}
    return encode(data, compress="zstd", zstd_level=1, predictor=predictor, **whole)


def encode(data: NDArray[Any], **options: Any) -> bytes:
    """Return the TIFF file of (H, W) or (H, W, channels) pixels; inverse: `decode`.

    Args:
        data: The pixels.
        options: What GDAL's GTiff driver is told, such as ``compress``.

    Raises:
        RenderError: They cannot be encoded.
    """
    planes = np.moveaxis(data, -1, 0) if data.ndim == 3 else data[None]
    count, height, width = planes.shape
    shape = {"height": height, "width": width, "count": count, "dtype": data.dtype}
    try:
        with MemoryFile() as memory:
            with without_georeference():
                file = memory.open(driver="GTiff", **shape, **options)
            with file:
                file.write(planes)
            return bytes(memory.getbuffer())
    except RasterioError as error:
        raise RenderError(f"a TIFF image could not be encoded: {error}") from error


def decode(file: bytes, name: str) -> NDArray[Any]:
    """Return the (H, W) or (H, W, channels) pixels in the bytes of a file; errors cite its name.

    Raises:
        InvalidInputError: It cannot be read.
    """
    with without_georeference(), open_geotiff(file, FRAME, name) as image:
        planes: NDArray[Any] = image.read()
    return planes[0] if len(planes) == 1 else np.moveaxis(planes, 0, -1)
