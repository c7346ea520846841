"""The pixel filter of denoised pictures, in which neighbours share the little light they have.

Cycles filters by where in a pixel it takes its samples, so that each of them serves one pixel only,
and takes the first one at the centre whatever the filter is: what that one saw by chance comes out
as detail. Filters that share samples between pixels leave less noise (Pharr, Jakob and Humphreys,
Physically Based Rendering, 3rd edition, 7.8): samples are taken from nearer to the centre, and the
rest of the filter is a convolution.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

CYCLES_WIDTH_PX = 1.5
"""Of the filter that noisy pictures go through, as Blender counts and by its default: the
Blackman-Harris window is twice as wide."""

SAMPLED_WIDTH_PX = 0.75
"""Of the filter that samples of denoised pictures are taken by."""

MANY_SHARE = 0.065
"""Part of its light that a pixel gives to each neighbour where samples are many: with it, the two
steps filter as widely as Cycles alone does at its own width."""

FEW_SHARE, FEW_SAMPLES = 0.095, 8
"""Part that it gives up to so many samples: the best one, against pictures of 512."""

GUIDE_SHARE = 0.06
"""Part of what guides the denoiser. It is worth a tenth of a decibel, and more does harm."""


def shared(light: NDArray[np.float32], samples: int) -> NDArray[np.float32]:
    """Return a picture in which neighbours share their light.

    Args:
        light: (H, W, 3) radiance, without noise.
        samples: Per pixel, that it was made of.
    """
    few = min(1.0, FEW_SAMPLES / max(samples, 1))
    return _mixed(light, MANY_SHARE + (FEW_SHARE - MANY_SHARE) * few)


def shared_guide(guide: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the (H, W, 3) albedo or normals of few samples, as neighbours share them."""
    return _mixed(guide, GUIDE_SHARE)


def _mixed(image: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    kernel = np.array([share, 1 - 2 * share, share], np.float32)
    whole = np.ascontiguousarray(image)
    filtered = cv2.sepFilter2D(whole, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(filtered, dtype=np.float32)
