"""Similarity of two colour images."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

WHITE = 255.0


def psnr_db(image: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Return the peak signal-to-noise ratio of (H, W, 3) images; ``inf`` where they are equal."""
    error = image.astype(np.float64) - reference.astype(np.float64)
    mean_square = float(np.mean(error**2))
    return float("inf") if mean_square == 0 else 10 * float(np.log10(WHITE**2 / mean_square))


def ssim(image: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Return the structural similarity (Wang et al., IEEE TIP 13(4), 2004), mean of channels."""
    per_channel, _ = cv2.quality.QualitySSIM_compute(image, reference)
    return float(np.mean(per_channel[:3]))
