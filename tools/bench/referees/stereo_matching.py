"""OpenCV's semi-global matcher on a pair of pictures, against their true disparities."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

DISPARITIES_PX = 64
"""Range that the matcher searches."""
BLOCK_PX = 5


@dataclass(frozen=True)
class StereoFigures:
    """How well disparities are found.

    Attributes:
        found_share: Share of the pixels that both pictures show, for which the matcher is sure.
        median_px: Median error.
        within_pixel_share: Share of the found ones with an error below 1 px.
    """

    found_share: float
    median_px: float
    within_pixel_share: float


def stereo_figures(
    left: NDArray[np.generic], right: NDArray[np.generic], true_px: NDArray[np.generic]
) -> StereoFigures:
    """Return the figures of a pair.

    Args:
        left, right: (H, W, 3) pictures.
        true_px: (H, W) disparities of the left one; 0: none.
    """
    matcher = cv2.StereoSGBM_create(
        numDisparities=DISPARITIES_PX,
        blockSize=BLOCK_PX,
        P1=8 * BLOCK_PX**2,
        P2=32 * BLOCK_PX**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=50,
        speckleRange=2,
    )
    grey = [cv2.cvtColor(np.asarray(each, np.uint8), cv2.COLOR_RGB2GRAY) for each in (left, right)]
    found_px = matcher.compute(*grey).astype(np.float32) / 16
    true = np.asarray(true_px, np.float32)
    in_both = (np.arange(true.shape[1]) >= true) & (true > 0) & (true < DISPARITIES_PX)
    judged = in_both & (found_px >= 0)
    error_px = np.abs(found_px - true)[judged]
    return StereoFigures(
        found_share=float(judged.sum() / in_both.sum()),
        median_px=float(np.median(error_px)),
        within_pixel_share=float(np.mean(error_px < 1)),
    )
