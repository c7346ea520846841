"""Pixels of TIFF images, read by GDAL: OpenCV and Pillow misread planes, floats and opacity."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_headers import (
    ASSOCIATED_ALPHA,
    CMYK,
    MIN_IS_BLACK,
    MIN_IS_WHITE,
    PALETTE,
    RGB,
    YCBCR,
    TiffHeader,
    tiff_header,
)
from oaisys_core.files.image_formats.image_use import ImageUse
from oaisys_core.files.image_formats.orientation import upright
from oaisys_core.files.image_formats.rasters import open_geotiff, without_georeference

_DTYPES = ("uint8", "uint16", "float16", "float32")
_SAMPLES = {
    MIN_IS_WHITE: (1, 2),
    MIN_IS_BLACK: (1, 2, 3, 4),
    RGB: (3, 4),
    PALETTE: (1,),
    CMYK: (4,),
    YCBCR: (3,),
}
"""Samples that a pixel may have, by their meaning."""
_CONVERTED = (CMYK, YCBCR)
"""Meanings that libtiff makes red, green and blue of, from 8 bits."""
_JPEG = 7


def read_tiff(data: bytes, use: ImageUse, name: str) -> NDArray[Any]:
    """Return the (H, W) or (H, W, 3 or 4) pixels of a TIFF file in OpenCV's order, blue first.

    They have 8 or 16 bits, or are float32. Other bits are scaled to these, a palette becomes its
    colours, 0 is black, the first row is the top one, and colours are not multiplied by opacity.
    The fourth channel is opacity, or what the file does not say, see `TiffHeader.has_alpha`.

    Args:
        data: The file, whose size has been checked.
        use: What the pixels are for; ids are never computed of other values.
        name: Of the file in errors.

    Raises:
        InvalidInputError: It cannot be read, or its values are of another kind.
    """
    from rasterio.errors import RasterioError

    try:
        header = tiff_header(data)
    except ValueError as error:
        raise use.refusal(name, error) from error
    _check_header(header, use, name)
    with without_georeference(), open_geotiff(data, use, name) as file:
        dtype = str(file.dtypes[0])
        if dtype not in _DTYPES:
            expected = f"{use.name} of 8 or 16 bits, or 32-bit floats, not {dtype}"
            raise InvalidInputError(use.field, name, expected)
        if file.count < header.samples:
            raise use.refusal(name, f"it has {file.count} channels, not {header.samples}")
        try:
            pixels = np.moveaxis(file.read(), 0, -1)
            palette = file.colormap(1) if header.meaning == PALETTE else {}
        except (RasterioError, ValueError) as error:
            raise use.refusal(name, "its pixels are damaged") from error
    if palette:
        pixels = _of_palette(pixels[..., 0], palette)
    else:
        pixels = _opaque(_values(pixels, header), header, use, name)
    if pixels.shape[2] == 2:  # grey, and opacity or what the file does not say
        is_kept = header.has_alpha and not use.is_of_numbers
        pixels = pixels[..., [0, 0, 0, 1] if is_kept else [0]]
    return np.ascontiguousarray(upright(_blue_first(pixels), header.orientation))


def _check_header(header: TiffHeader, use: ImageUse, name: str) -> None:
    """Raise if it is not known what the samples are."""
    meaning = header.meaning
    is_grey = meaning in (MIN_IS_WHITE, MIN_IS_BLACK)
    if header.samples not in _SAMPLES.get(meaning, ()):
        expected = (
            f"{use.name} that is grey or has a palette or colours as RGB, not {header.samples}"
            f" channels of TIFF's photometric interpretation {meaning}"
        )
    elif meaning in _CONVERTED and header.bits != 8:
        expected = f"{use.name} with colours as RGB, not CMYK or YCbCr of {header.bits} bits"
    elif not use.is_of_numbers:
        return
    elif is_grey and header.samples > 2:
        expected = (
            f"{use.name} that is grey, or whose {header.samples} channels are colours:"
            " TIFF's photometric interpretation is grey"
        )
    elif meaning in _CONVERTED and not (meaning == YCBCR and header.compression == _JPEG):
        expected = f"{use.name} with colours as RGB, not CMYK or YCbCr"
    else:
        return
    raise InvalidInputError(use.field, name, expected)


def _of_palette(
    indices: NDArray[Any], palette: dict[int, tuple[int, int, int, int]]
) -> NDArray[np.uint8]:
    colors = np.zeros((max(int(indices.max()), *palette) + 1, 3), np.uint8)
    for index, color in palette.items():
        colors[index] = color[:3]
    return np.asarray(colors[indices])


def _values(pixels: NDArray[Any], header: TiffHeader) -> NDArray[Any]:
    """Return samples of 8 or 16 bits or floats, in which 0 is black."""
    if header.meaning in _CONVERTED:
        return pixels[..., :3]  # libtiff adds opacity
    if pixels.dtype.kind == "f":
        return pixels.astype(np.float32, copy=False)
    largest = 2**header.bits - 1
    if header.meaning == MIN_IS_WHITE:
        pixels[..., 0] = largest - pixels[..., 0]
    full = np.iinfo(pixels.dtype).max
    if largest == full:
        return pixels
    scaled = (pixels.astype(np.uint32) * full + largest // 2) // largest
    return np.asarray(scaled, pixels.dtype)


def _opaque(pixels: NDArray[Any], header: TiffHeader, use: ImageUse, name: str) -> NDArray[Any]:
    """Return pixels whose colours are not multiplied by opacity.

    Raises:
        InvalidInputError: Ids are.
    """
    if not (header.has_alpha and header.extra == ASSOCIATED_ALPHA):
        return pixels
    full = 1.0 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
    alpha = pixels[..., -1:]
    if use.is_of_numbers:
        if (alpha == full).all():
            return pixels
        expected = f"{use.name} whose values are not multiplied by opacity (associated alpha)"
        raise InvalidInputError(use.field, name, expected)
    share = np.maximum(alpha / np.float64(full), np.finfo(np.float32).tiny)
    colors = np.where(alpha > 0, pixels[..., :-1] / share, 0)
    if pixels.dtype.kind != "f":
        colors = np.rint(np.minimum(colors, full))
    return np.concatenate([colors.astype(pixels.dtype), alpha], axis=-1)


def _blue_first(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return one channel as (H, W), and colours blue first."""
    channels = pixels.shape[2]
    return pixels[..., 0] if channels == 1 else pixels[..., [2, 1, 0, *range(3, channels)]]
