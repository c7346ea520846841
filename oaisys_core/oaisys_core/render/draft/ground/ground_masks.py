"""The weights of the ground's layers at points, and its tone, as their images have them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.render.draft.appearance import Floats, put, take
from oaisys_core.render.draft.ground.texture_atlas import sample
from oaisys_core.scene.terrain_material import MAX_TONE, MIN_TONE, TerrainMaterial
from oaisys_core.types import FloatArray

CHANNELS = 4
"""Most channels of an image that OpenCV interpolates at once."""


class GroundMasks:
    """Looks up the weights of layers on the stage and on the land around it."""

    def __init__(self, material: TerrainMaterial) -> None:
        """Take over the masks of a material."""
        self._extent_m = material.extent_m
        self._count = len(material.layers)
        self._images = _images(material.masks)
        self._tone = material.tone
        self._land = material.land
        self._of_land: list[NDArray[np.float32]] | None = None

    def weights(self, xy_m: FloatArray) -> Floats:
        """Return the (N, L) weights at (N, 2) points."""
        if self._count == 1:
            return np.ones((len(xy_m), 1), np.float32)
        x, y = self._place(xy_m, self._images[0])
        weights = self._look_up(self._images, x, y, cv2.BORDER_REFLECT)
        if self._land is None or not self._is_any_beyond(xy_m):
            return weights
        share = self._land.share_at(xy_m).astype(np.float32)
        beyond = np.flatnonzero(share)
        if self._of_land is None:
            self._of_land = _images(self._land.weights)
        of_land = self._look_up(self._of_land, *self._land.texels_at(xy_m[beyond]), cv2.BORDER_WRAP)
        before = take(weights, beyond)
        put(weights, beyond, before + share[beyond, None] * (of_land - before))
        return weights

    def tone(self, xy_m: FloatArray) -> Floats:
        """Return the (N, 3) factors of the ground's tone at (N, 2) points."""
        assert self._tone is not None
        x, y = (each.astype(np.float32) for each in self._place(xy_m, self._tone.pixels))
        share = sample(self._tone.pixels, x, y, cv2.BORDER_REPLICATE)
        return np.asarray(share * np.float32((MAX_TONE - MIN_TONE) / 255) + np.float32(MIN_TONE))

    def _place(self, xy_m: FloatArray, image: NDArray[Any]) -> tuple[FloatArray, FloatArray]:
        """Return the columns and rows of (N, 2) points in an image of the stage."""
        x0, y0, x1, y1 = self._extent_m
        rows, columns = image.shape[:2]
        x = (xy_m[:, 0] - x0) * (columns / (x1 - x0)) - 0.5
        return x, (xy_m[:, 1] - y0) * (rows / (y1 - y0)) - 0.5

    def _is_any_beyond(self, xy_m: FloatArray) -> bool:
        x0, y0, x1, y1 = self._extent_m
        low, high = xy_m.min(axis=0), xy_m.max(axis=0)
        return bool(low[0] < x0 or low[1] < y0 or high[0] > x1 or high[1] > y1)

    def _look_up(
        self, images: list[NDArray[np.float32]], x: FloatArray, y: FloatArray, border: int
    ) -> Floats:
        at = x.astype(np.float32), y.astype(np.float32)
        found = [np.atleast_2d(sample(image, *at, border).T).T for image in images]
        return np.asarray(found[0] if len(found) == 1 else np.concatenate([w.T for w in found]).T)


def _images(masks: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return (R, C, up to 4) images of (L, R, C) masks."""
    return [
        np.ascontiguousarray(np.moveaxis(masks[first : first + CHANNELS], 0, -1))
        for first in range(0, len(masks), CHANNELS)
    ]
