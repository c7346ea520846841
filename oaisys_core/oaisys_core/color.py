"""Conversions between linear and sRGB-encoded colour values."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.types import FloatArray

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue (ITU-R BT.709)."""

EXACT_COUNT = 1 << 24
"""Pixels that OpenCV's histograms count exactly, in 32-bit numbers."""

AnyFloat = TypeVar("AnyFloat", np.float32, np.float64)


def linear(srgb: ArrayLike) -> FloatArray:
    """Return the linear values of sRGB-encoded ones, 0 to 1 (IEC 61966-2-1); inverse: `srgb`."""
    s = np.asarray(srgb, dtype=np.float64)
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def mean_linear(srgb_bytes: NDArray[np.uint8]) -> FloatArray:
    """Return the (3,) mean of the linear values of (..., 3) sRGB-encoded bytes."""
    import cv2

    levels = linear(np.arange(256) / 255)
    pixels = np.ascontiguousarray(srgb_bytes).reshape(-1, 1, 3)
    counts = np.zeros((3, 256))
    for first in range(0, len(pixels), EXACT_COUNT):
        block = [pixels[first : first + EXACT_COUNT]]
        for channel in range(3):
            counts[channel] += cv2.calcHist(block, [channel], None, [256], [0, 256]).ravel()
    return np.asarray(counts @ levels / len(pixels))


def srgb(linear_color: NDArray[AnyFloat]) -> NDArray[AnyFloat]:
    """Return the sRGB-encoded values of linear ones, in the same precision; inverse: `linear`."""
    bright = 1.055 * np.maximum(linear_color, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear_color <= 0.0031308, 12.92 * linear_color, bright)


def encode_srgb(linear_color: NDArray[AnyFloat]) -> NDArray[np.uint8]:
    """Return linear values as sRGB bytes, after clipping to 0 to 1."""
    return np.asarray(np.rint(srgb(np.clip(linear_color, 0.0, 1.0)) * 255), dtype=np.uint8)
