"""Opens images from outside: their sizes are read from headers and bounded before decoding."""

from __future__ import annotations

import io
import logging
import threading
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import read_bytes
from oaisys_core.files.image_formats.color_spaces import check_primaries
from oaisys_core.files.image_formats.image_headers import (
    StoredValues,
    image_size,
    is_png,
    is_tiff,
    png_transparent,
    values_of,
)
from oaisys_core.files.image_formats.image_use import MESH_TEXTURE, ImageUse
from oaisys_core.files.image_formats.orientation import exif_orientation, upright
from oaisys_core.files.image_formats.pictures import count_pictures
from oaisys_core.files.image_formats.radiance import has_new_runs, plain_radiance, radiance_header

LOG = logging.getLogger(__name__)

_TEXT_PNM = (b"P1", b"P2", b"P3")
"""Beginnings of files whose pixels are text."""


def read_file(path: Path, use: ImageUse) -> bytes:
    """Return the bytes of an image's file.

    Raises:
        InvalidInputError: It cannot be read, or is too large.
    """
    try:
        return read_bytes(path, use.most_bytes)
    except (OSError, ValueError) as error:
        raise use.refusal(str(path), error) from error


def read_pixels(path: Path, use: ImageUse, flags: int | None = None) -> NDArray[Any]:
    """Return the (H, W) or (H, W, channels) pixels of a file in OpenCV's order, blue first.

    Args:
        path: The file.
        use: Bounds its size.
        flags: Of ``cv2.imdecode``: those of an image that becomes grey; None: as the file is.

    Raises:
        InvalidInputError: It is too large, or cannot be read.
    """
    return decode_pixels(read_file(path, use), use, str(path), flags)


def decode_pixels(data: bytes, use: ImageUse, name: str, flags: int | None = None) -> NDArray[Any]:
    """Return the pixels of a file's bytes, see `read_pixels`; errors call it ``name``.

    Raises:
        InvalidInputError: It is too large, or cannot be read.
    """
    import cv2

    try:
        size = image_size(data)
        values = values_of(data)
        # Coordinates of a mesh's textures are those of the pixels as they are stored.
        orientation = 1 if use is MESH_TEXTURE else exif_orientation(data)
        transparent = png_transparent(data) if is_png(data) else None
        check_pictures(data, use, name)
    except ValueError as error:
        raise use.refusal(name, error) from error
    use.check(*size, name)
    _check_values(values, use, name)
    if not (is_tiff(data) or data.startswith(b"BM")):
        read = cv2.IMREAD_UNCHANGED if flags is None else flags | cv2.IMREAD_IGNORE_ORIENTATION
        image = _decode(data, use, name, read)
        bits = 8 if values.largest.bit_length() <= 8 else 16
        if image.dtype.itemsize * 8 != bits or image.shape[1::-1] != size:
            found = f"{image.shape[1]} x {image.shape[0]} pixels of {image.dtype}"
            raise use.refusal(name, f"{found}, not {size[0]} x {size[1]} of {bits} bits")
        full = np.iinfo(image.dtype).max
        is_opacity_read = flags is None and (use.has_voids or not use.is_of_numbers)
        if transparent is not None and is_opacity_read and image.shape[2:] != (4,):
            image = _with_alpha(image, [value * full // values.largest for value in transparent])
        return np.ascontiguousarray(upright(image, orientation))
    image = _decode_tiff(data, use, name) if is_tiff(data) else _decode_bmp(data, use, name)
    if flags is None or image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_BGR2GRAY))


def check_pictures(data: bytes, use: ImageUse, name: str) -> None:
    """Warn of a file with several pictures, pages or frames; of ids and heights none can be meant.

    Raises:
        InvalidInputError: The file has several, and pixels are numbers.
    """
    count = count_pictures(data)
    if count == 1:
        return
    if use.is_of_numbers:
        raise InvalidInputError(use.field, name, f"{use.name} of one picture, not of {count}")
    LOG.warning("%s: it has %d pictures, of which the first is read", name, count)


def _with_alpha(image: NDArray[Any], transparent: list[int]) -> NDArray[Any]:
    """Return blue, green, red and opacity of a PNG whose transparent value OpenCV left out."""
    colors = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
    is_clear = (colors == np.array(transparent[::-1], colors.dtype)).all(axis=-1)
    alpha = np.where(is_clear, 0, np.iinfo(colors.dtype).max).astype(colors.dtype)
    return np.dstack((colors, alpha))


def _check_values(values: StoredValues, use: ImageUse, name: str) -> None:
    """Raise if the decoder would change values that count, or leave those that it should scale."""
    bits = values.largest.bit_length()
    usual = (255, 65535)
    if values.largest not in usual and (use.is_of_numbers or not values.is_scaled):
        expected = (
            f"{use.name} of 8 or 16 bits, whose largest value is 255 or 65535, not {values.largest}"
            f" ({bits} bits)"
        )
        raise InvalidInputError(use.field, name, expected)
    if values.starts_white and (use.is_of_numbers or bits > 8):
        expected = f"{use.name} in which 0 is black, not white (TIFF's MinIsWhite)"
        raise InvalidInputError(use.field, name, expected)


def read_radiance_file(path: Path, use: ImageUse) -> NDArray[np.float32]:
    """Return the (H, W, 3) radiance in a Radiance file in OpenCV's order, blue first.

    By the format's standard it is the pixels divided by all exposures that the header names.

    Raises:
        InvalidInputError: It is too large, or cannot be read.
    """
    import cv2

    data = read_file(path, use)
    try:
        header = radiance_header(data)
        width, height, start, factors, primaries = header
        use.check(width, height, str(path))
        if has_new_runs(data, header):
            # A header of our own, as another reader may find another size in that of the file.
            head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width)
            pixels = _decode(head + data[start:], use, str(path), cv2.IMREAD_UNCHANGED)
        else:
            pixels = plain_radiance(data, header)[..., ::-1]
    except ValueError as error:
        raise use.refusal(str(path), error) from error
    if primaries:
        check_primaries(primaries, use, str(path))
    if factors != (1.0, 1.0, 1.0):
        pixels /= np.asarray(factors[::-1], np.float32)
    return pixels


def _decode(data: bytes, use: ImageUse, name: str, flags: int) -> NDArray[Any]:
    """Return what OpenCV reads."""
    import cv2

    # The last number of a text may end the file, which OpenCV does not expect.
    data = data + b"\n" if data.startswith(_TEXT_PNM) else data
    try:
        with _quiet:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise use.refusal(name, error.err) from error
    if image is None:
        raise use.refusal(name, "its pixels are damaged")
    return np.asarray(image)


class _Quiet:
    """Keeps OpenCV from writing lines before an error of ours, while any thread is inside."""

    def __init__(self) -> None:
        self._lock, self._inside, self._level = threading.Lock(), 0, 0

    def __enter__(self) -> None:
        with self._lock:
            if self._inside == 0:
                self._level = _set_log_level(0)
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                _set_log_level(self._level)


def _set_log_level(level: int) -> int:
    """Set what OpenCV 4 or 5 writes, and return what it was."""
    import cv2

    place: Any = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging
    return int(place.setLogLevel(level))


_quiet = _Quiet()


def _decode_tiff(data: bytes, use: ImageUse, name: str) -> NDArray[Any]:
    from oaisys_core.files.image_formats.tiff_pixels import read_tiff  # which imports this module

    return read_tiff(data, use, name)


def _decode_bmp(data: bytes, use: ImageUse, name: str) -> NDArray[np.uint8]:
    """Return what Pillow reads: OpenCV takes some headers for others."""
    from PIL.BmpImagePlugin import BmpImageFile

    try:
        with BmpImageFile(io.BytesIO(data)) as image:
            is_grey = image.mode in ("1", "L")
            mode = "L" if is_grey else "RGBA" if image.mode == "RGBA" else "RGB"
            pixels = np.asarray(image.convert(mode))
    except (OSError, ValueError, SyntaxError) as error:
        raise use.refusal(name, error) from error
    return pixels if is_grey else np.ascontiguousarray(pixels[..., [2, 1, 0, 3][: pixels.shape[2]]])
