"""The pixels of a texture map as its format defines them; what is unusual in them is told."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import srgb
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.color_spaces import check_exr_primaries, gamma_of
from oaisys_core.files.image_formats.image_use import TEXTURE
from oaisys_core.files.image_formats.images import decode_pixels, read_file
from oaisys_core.output.exr import read_channels

LOG = logging.getLogger(__name__)

Image = NDArray[np.float32]

_GREY_STEP = 0.02
"""Difference of channels that is more than the noise of JPEG."""


def read_color(path: Path) -> Image:
    """Return (H, W, 3) sRGB-encoded colour, 0 to 1.

    EXR images and TIFF images of floats have linear colour, PNG images what their gamma says.

    Raises:
        InvalidInputError: It cannot be read, or has other primaries.
    """
    image, gamma = read_map(path)
    color = image[..., :3]
    if image.shape[2] == 4 and (image[..., 3] < 1).any():
        LOG.warning("%s: its transparency is left aside: ground has no holes", path)
        color = _without_opacity(image) if is_exr(path) else color
    if is_exr(path):
        check_exr_primaries(path, TEXTURE)
    if (share := float((color > 1).any(axis=-1).mean())) > 0:
        LOG.warning("%s: %.1f %% of its colours are above 1, and clipped", path, 100 * share)
    color = np.clip(color, 0, 1)
    if gamma is None:
        return color
    LOG.info("%s: its colours are light to the power of %g", path, gamma)
    return srgb(color if gamma == 1 else color ** np.float32(1 / gamma))


def _without_opacity(image: Image) -> Image:
    """Return colours that EXR, by its standard, has multiplied by their opacity."""
    alpha = image[..., 3:]
    return np.divide(image[..., :3], alpha, out=image[..., :3].copy(), where=alpha > 0)


def read_grey(path: Path, channel: int = 0) -> Image:
    """Return one channel, (H, W) from 0 to 1; linear, whatever the file says.

    Raises:
        InvalidInputError: It cannot be read, or has no such channel.
    """
    image, _ = read_map(path)
    if channel >= image.shape[2]:
        raise InvalidInputError("folder", str(path), f"an image with {channel + 1} channels")
    return np.clip(image[..., channel], 0, 1)


def read_single(path: Path) -> Image:
    """Return a grey map, (H, W) from 0 to 1; of colours the red, with a warning.

    Raises:
        InvalidInputError: It cannot be read.
    """
    image, _ = read_map(path)
    if np.ptp(image[..., :3], axis=-1).max() > _GREY_STEP:
        LOG.warning("%s: it is coloured, and its red channel is used", path)
    return np.clip(image[..., 0], 0, 1)


def read_height(path: Path) -> Image:
    """Return a height map, (H, W) from 0 to 1; floats beyond that are scaled, with a warning.

    Raises:
        InvalidInputError: It cannot be read.
    """
    image, _ = read_map(path)
    height = image[..., 0]
    least, most = float(height.min()), float(height.max())
    if least >= 0 and most <= 1:
        return height
    LOG.warning("%s: its heights from %g to %g are scaled to 0 to 1", path, least, most)
    return (height - np.float32(least)) / np.float32(most - least or 1.0)


def read_normals(path: Path) -> Image:
    """Return the components of normals, (H, W, 3) from -1 to 1, as the file has them.

    Raises:
        InvalidInputError: It cannot be read, or is grey.
    """
    image = read_map(path)[0][..., :3]
    if np.ptp(image, axis=-1).max() < _GREY_STEP:
        expected = "normals as red, green and blue; this is grey, perhaps a height map"
        raise InvalidInputError("folder", str(path), expected)
    if float(image.min()) < -_GREY_STEP:  # floats from -1 to 1
        return np.asarray(np.clip(image, -1, 1), np.float32)
    normals = np.asarray(2 * np.clip(image, 0, 1) - 1, np.float32)
    if float(image[..., 2].max()) < _GREY_STEP:
        LOG.warning("%s: it has no z, which is derived from x and y", path)
        squares = (normals[..., :2] ** 2).sum(axis=-1)
        normals[..., 2] = np.sqrt(np.clip(1 - squares, 0, 1))
    return normals


def is_exr(path: Path) -> bool:
    """Return whether a map is read as an EXR image."""
    return path.suffix.lower() == ".exr"


def read_map(path: Path) -> tuple[Image, float | None]:
    """Return an image as (H, W, 3 or 4) red first, integers as 0 to 1, and its colours' gamma.

    The gamma is None for sRGB.

    Raises:
        InvalidInputError: It cannot be read, or has values that are not finite.
    """
    image, gamma = (_exr_image(path), 1.0) if is_exr(path) else _plain_image(path)
    if not np.isfinite(image).all():
        raise InvalidInputError("folder", str(path), "a map of finite numbers")
    return image, gamma


def _exr_image(path: Path) -> Image:
    channels = _one_layer(read_channels(path, TEXTURE), path)
    colors = [name for name in channels if name != "A"] or ["A"]
    if len(colors) == 1:
        names = colors * 3
    elif set(colors) >= set("RGB"):
        names = ["R", "G", "B"]
    else:
        expected = f"channels R, G and B, or one alone, not {', '.join(channels)}"
        raise InvalidInputError("folder", str(path), expected)
    names += ["A"] * ("A" in channels and colors != ["A"])
    if channels[names[0]].dtype.kind != "f":
        raise InvalidInputError("folder", str(path), "a map of floats, not of integers, as EXR")
    return np.asarray(np.stack([channels[name] for name in names], axis=-1), np.float32)


def _one_layer(channels: Mapping[str, NDArray[Any]], path: Path) -> dict[str, NDArray[Any]]:
    """Return the channels without a layer, else those of the only layer, by their last letters."""
    layers: dict[str, dict[str, NDArray[Any]]] = {}
    for name, values in channels.items():
        layer, _, letters = name.rpartition(".")
        layers.setdefault(layer, {})[letters] = values
    if "" in layers:
        return layers[""]
    if len(layers) > 1:
        expected = f"an image with one layer, not {', '.join(layers)}"
        raise InvalidInputError("folder", str(path), expected)
    return next(iter(layers.values()))


def _plain_image(path: Path) -> tuple[Image, float | None]:
    data = read_file(path, TEXTURE)
    image = decode_pixels(data, TEXTURE, str(path))
    if image.dtype not in (np.uint8, np.uint16, np.float32):
        expected = f"a map of 8 or 16 bits, or 32-bit floats, not {image.dtype}"
        raise InvalidInputError("folder", str(path), expected)
    is_float = image.dtype.kind == "f"
    scale = 1.0 if is_float else np.iinfo(image.dtype).max
    pixels = np.asarray(image / np.float32(scale), np.float32)
    return _red_first(pixels), 1.0 if is_float else gamma_of(data, str(path))


def _red_first(image: Image) -> Image:
    if image.ndim == 2:
        image = image[..., None]
    if image.shape[2] < 3:
        return np.repeat(image[..., :1], 3, axis=2)
    return image[..., (2, 1, 0, *range(3, image.shape[2]))]
