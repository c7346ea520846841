"""The weights of the ground's layers over the pixels of a view, by their masks."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene.terrain_material import TerrainMaterial
from oaisys_core.types import FloatArray

Image = NDArray[np.float32]


class LandPlaces(NamedTuple):
    """Where the points of (R, W) pixels are in the masks of the land around a stage.

    Attributes:
        weights: The masks of all layers but the first, see `LandMasks`.
        share: Their weight over the stage's masks.
        columns, rows: Places in them.
    """

    weights: Image
    share: Image
    columns: FloatArray
    rows: FloatArray

    def weight(self, layer: int) -> Image:
        """Return the (R, W) weight of a layer."""
        return bilinear(self.weights[layer], self.columns, self.rows, cv2.BORDER_WRAP)


def pixel_weights(material: TerrainMaterial, xy_m: FloatArray) -> list[Image]:
    """Return the (H, W) weight of each layer at (H, W, 2) points, as `layer_shares` has them."""
    first = np.ones(xy_m.shape[:2], np.float32)
    weights: list[Image] = []
    if len(material.layers) > 1:
        x, y = places_on_stage(material, xy_m, material.masks.shape[1])
        on_land = _places_on_land(material, xy_m)
        for layer, mask in enumerate(material.masks[1:]):
            weight = bilinear(mask, x, y, cv2.BORDER_REFLECT)
            if on_land is not None:
                weight += (on_land.weight(layer) - weight) * on_land.share
            weights.append(weight)
            first -= weight
    return [first, *weights]


def places_on_stage(
    material: TerrainMaterial, xy_m: FloatArray, size: int
) -> tuple[FloatArray, FloatArray]:
    """Return columns and rows of (H, W, 2) points in an image of the stage of some size."""
    x0, y0, x1, y1 = material.extent_m
    column = (xy_m[..., 0] - x0) * (size / (x1 - x0)) - 0.5
    return column, (xy_m[..., 1] - y0) * (size / (y1 - y0)) - 0.5


def bilinear(image: NDArray[Any], x: FloatArray, y: FloatArray, border: int) -> NDArray[Any]:
    """Return an image, interpolated at (R, W) columns and rows."""
    places = x.astype(np.float32), y.astype(np.float32)
    return np.asarray(cv2.remap(image, *places, cv2.INTER_LINEAR, borderMode=border))


def _places_on_land(material: TerrainMaterial, xy_m: FloatArray) -> LandPlaces | None:
    """Return the places of points in the masks of the land; None if all are on the stage."""
    land = material.land
    share = None if land is None else land.share_at(xy_m)
    if land is None or share is None or not share.any():
        return None
    return LandPlaces(land.weights[1:], share.astype(np.float32), *land.texels_at(xy_m))
