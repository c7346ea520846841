"""Pixels of the images in a .blend file: those packed into it, beside it, or made by Blender."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import encode_srgb
from oaisys_core.files.image_formats.exr_headers import data_window_size
from oaisys_core.files.image_formats.image_headers import image_size
from oaisys_core.files.image_formats.image_use import MESH_TEXTURE
from oaisys_core.files.image_formats.images import read_file
from oaisys_core.files.image_formats.radiance import radiance_header

MAX_PIXELS = 8 * MESH_TEXTURE.most_px
"""Of the images of a file together: Blender has 4 bytes or floats for each."""

_EXR_START = b"\x76\x2f\x31\x01"


def image_pixels(image: Any) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None] | None:
    """Return (H, W, 3) colours in sRGB and (H, W) alpha of an image; None: it is missing.

    `too_many_pixels` has been asked about it, since Blender decodes all to tell its size.

    Raises:
        InvalidInputError: It has too many pixels.
    """
    if image is None:
        return None
    if not image.has_data and not image.pixels:
        return None
    width, height = image.size
    MESH_TEXTURE.check(width, height, image.name)
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    pixels = np.clip(values.reshape(height, width, -1)[::-1], 0, 1)
    rgb = pixels[..., :3] if image.channels >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    is_linear = image.is_float or image.colorspace_settings.is_data
    colors = encode_srgb(rgb) if is_linear else np.rint(rgb * 255).astype(np.uint8)
    alpha = np.rint(pixels[..., 3] * 255).astype(np.uint8) if image.channels == 4 else None
    return np.ascontiguousarray(colors), alpha


def too_many_pixels(images: Iterable[Any]) -> str | None:
    """Return what is expected instead of images that have too many pixels together.

    None of them is decoded.

    Args:
        images: Each as often as it is read.

    Raises:
        InvalidInputError: One alone has too many.
    """
    pixels: dict[str, int] = {}
    total = 0
    for image in images:
        if image.name_full not in pixels:
            pixels[image.name_full] = _number_of_pixels(image)
        total += pixels[image.name_full]
    if total <= MAX_PIXELS:
        return None
    return f"images of at most {MAX_PIXELS} pixels together, not {total}"


def _number_of_pixels(image: Any) -> int:
    """Return the pixels of an image by its headers; raise if there are too many."""
    total = 0
    if image.source == "GENERATED":
        MESH_TEXTURE.check(image.generated_width, image.generated_height, image.name)
        total = image.generated_width * image.generated_height
    for data in _files_of(image):
        try:
            sizes = list(_sizes(data))
        except (OSError, RuntimeError, ValueError, TypeError, KeyError):
            continue  # a format that only Blender knows, within its reader's memory and time
        for width, height in sizes:
            MESH_TEXTURE.check(width, height, image.name)
            total += width * height
    return total


def _sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield the width and height of each image in a file."""
    if data.startswith(b"#?"):
        header = radiance_header(data)
        yield header.width, header.height
    elif data.startswith(_EXR_START):
        import OpenEXR

        with OpenEXR.File(io.BytesIO(data), header_only=True) as file:
            for part in file.parts:
                yield data_window_size(part.header)
    else:
        yield image_size(data)


def _files_of(image: Any) -> list[bytes]:
    """Return the contents of the files of an image, packed or beside the .blend file."""
    if image.packed_files:
        return [bytes(each.packed_file.data) for each in image.packed_files if each.packed_file]
    if not image.filepath:
        return []
    numbers = [str(tile.number) for tile in image.tiles] or [""]
    names = [image.filepath.replace("<UDIM>", number) for number in numbers]
    paths = [Path(bpy.path.abspath(name, library=image.library)) for name in names]
    return [read_file(path, MESH_TEXTURE) for path in paths if path.is_file()]
