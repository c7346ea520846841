"""The filter by which a pixel shows a little of its neighbours, too, as those of Cycles do."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.raycast.surface import Surface
from oaisys_core.raycast.view import View
from oaisys_core.render.draft.appearance import Floats

FILTER_SHARE = 0.1
"""Share of its light that a pixel gives to each neighbour, in both directions."""

PIXEL_FILTER = np.array((FILTER_SHARE, 1 - 2 * FILTER_SHARE, FILTER_SHARE), np.float32)

THIN_FILTER = np.array((0.27, 0.46, 0.27), np.float32)
"""The same weights where a pixel shows another thing than most pixels around it."""


def filter_pixels(image: Floats, surface: Surface, view: View) -> Floats:
    """Return an (H, W, 3) image as a pixel's filter has it, wider where things are thinner."""
    filtered = np.empty_like(image)
    height, width = view.instance_ids.shape

    def work(rows: slice) -> None:
        first, end = max(rows.start - 1, 0), min(rows.stop + 1, height)
        inner = slice(rows.start - first, rows.stop - first)
        some = image[first:end]
        filtered[rows] = _filtered(some, PIXEL_FILTER)[inner]
        ids = view.instance_ids[first:end]
        if (ids == ids[0, 0]).all():
            return
        is_thin = _is_thin(ids)[inner]
        if is_thin.any():
            filtered[rows][is_thin] = _filtered(some, THIN_FILTER)[inner][is_thin]

    surface.each_band((height, width), work)
    return filtered


def _filtered(image: Floats, weights: Floats) -> Floats:
    border = cv2.BORDER_REFLECT
    return np.asarray(cv2.sepFilter2D(image, -1, weights, weights, borderType=border))


def _is_thin(instance_ids: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return (H, W) pixels that show another thing than most pixels around them."""
    height, width = instance_ids.shape
    ids = np.pad(instance_ids, 1, mode="edge")
    others = np.zeros((height, width), np.uint8)
    for row in range(3):
        for column in range(3):
            others += ids[row : row + height, column : column + width] != instance_ids
    # Beside a straight edge there are three.
    return np.asarray(others > 3)
