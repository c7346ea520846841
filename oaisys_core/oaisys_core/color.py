"""sRGB's encoding."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.types import FloatArray


def linear(srgb: ArrayLike) -> FloatArray:
    """Return linear values of sRGB-encoded ones in 0 to 1 (IEC 61966-2-1); inverse: `encoded`."""
    s = np.asarray(srgb, dtype=np.float64)
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def encoded(linear_color: FloatArray) -> NDArray[np.uint8]:
    """Return sRGB bytes of linear values, clipped to 0 to 1; inverse: `linear`."""
    c = np.clip(linear_color, 0.0, 1.0)
    srgb = np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(srgb * 255), dtype=np.uint8)
