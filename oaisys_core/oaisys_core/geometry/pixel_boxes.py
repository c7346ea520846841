"""The boxes of what an image of ids shows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class PixelBoxes(NamedTuple):
    """What an image shows of N ids, by rising id.

    Attributes:
        ids: (N,) int64.
        pixels: (N,) int64 numbers of pixels.
        boxes_px: (N, 4) int64 left, top, width and height in pixels from the image's corner.
    """

    ids: NDArray[np.int64]
    pixels: NDArray[np.int64]
    boxes_px: NDArray[np.int64]


def pixel_boxes(image: NDArray[Any]) -> PixelBoxes:
    """Return what an image (H, W) of ids shows of those above 0."""
    from scipy import ndimage

    ids, inverse, counts = np.unique(image, return_inverse=True, return_counts=True)
    slices = ndimage.find_objects(inverse.reshape(image.shape) + 1)
    boxes = np.array(
        [(x.start, y.start, x.stop - x.start, y.stop - y.start) for y, x in slices], np.int64
    ).reshape(-1, 4)
    is_object = ids > 0
    return PixelBoxes(ids[is_object].astype(np.int64), counts[is_object], boxes[is_object])
