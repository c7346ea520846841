"""Salt and pepper in pictures: pixels that differ from those around them by noise alone."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

NOISE = 12.0
"""Difference of brightness, of 255, below which noise is not seen."""


def speckle_share(picture: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Return the share of pixels that differ from the median around them by more than noise.

    Stones and blades of grass differ, too. What is not noise is in a picture of the same view with
    many samples, at the same pixel or beside it.

    Args:
        picture: (H, W, 3) sRGB bytes.
        reference: (H, W, 3) the view at quality ``final``.
    """
    known = cv2.dilate(_from_median(reference), np.ones((3, 3), np.uint8))
    return float(np.mean(_from_median(picture) > known + NOISE))


def _from_median(picture: NDArray[np.uint8]) -> NDArray[Any]:
    """Return (H, W) by how much a pixel's brightness differs from the median of 3 x 3 pixels."""
    brightness = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.asarray(np.abs(brightness - cv2.medianBlur(brightness, 3)))
