"""Where the textures of the ground's layers are seen at its points, and what they show there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.procedural.textures.borders import MAX_HEIGHT, MIN_HEIGHT
from oaisys_core.scene.terrain_material import TerrainLayer
from oaisys_core.types import FloatArray

Image = NDArray[np.float32]

_HEIGHTS = np.linspace(MIN_HEIGHT, MAX_HEIGHT, 256)
LINEAR = np.stack((*[linear(np.arange(256) / 255)] * 3, _HEIGHTS), axis=-1)
LINEAR = LINEAR.astype(np.float32)[None]
"""Linear values of bytes in sRGB, and heights (see `borders`) of those in the last channel."""


@dataclass(frozen=True)
class LayerPlaces:
    """Where the K copies of a layer's texture are seen by (R, W) pixels, see `TextureSamples`.

    Attributes:
        tile_m: Edge length of a tile.
        uv_tiles: K arrays of (R, W, 2) coordinates of the pixels' middles.
        weights: K arrays of (R, W) weights.
        turn: (2, R, W) cosine and sine of the first copy's rotation; None: none.
    """

    tile_m: float
    uv_tiles: list[FloatArray]
    weights: list[Image]
    turn: FloatArray | None

    @staticmethod
    def of(layer: TerrainLayer, xy_m: FloatArray) -> LayerPlaces:
        """Return the places of a layer at (R, W, 2) points."""
        shape, tile_m = xy_m.shape[:2], layer.maps.tile_m
        samples = layer.tiling.samples((xy_m / tile_m).reshape(-1, 2))
        return LayerPlaces(
            tile_m,
            [uv.reshape(*shape, 2) for uv in samples.uv_tiles],
            [weight.reshape(shape).astype(np.float32) for weight in samples.weights],
            None if samples.turn is None else samples.turn.reshape(2, *shape),
        )

    def look_up(self, image: NDArray[np.uint8], mean: Image, step_m: FloatArray) -> Image:
        """Return the (R, W, 4) linear colour and height beside the pixels' middles.

        Args:
            image: (S, S, 4) texture of colour in sRGB, and height.
            mean: (3,) its mean linear colour, from which copies are blended as contrasty as each.
            step_m: (R, W, 2) way from the middles. No copy changes along it.
        """
        step_tiles = step_m / self.tile_m
        first = step_tiles if self.turn is None else _turned(step_tiles, self.turn)
        texel = _looked_up(image, self.uv_tiles[0] + first)
        if len(self.weights) == 1:
            return texel
        texel *= self.weights[0][..., None]
        squares = np.square(self.weights[0])
        for uv_tiles, weight in zip(self.uv_tiles[1:], self.weights[1:], strict=True):
            texel += _looked_up(image, uv_tiles + step_tiles) * weight[..., None]
            squares += np.square(weight)
        color = texel[..., :3]
        color[:] = np.maximum(mean + (color - mean) / np.sqrt(squares)[..., None], 0)
        return texel

    def look_up_plain(self, image: NDArray[np.uint8]) -> Image:
        """Return the (R, W) values of an (S, S) image of numbers in the pixels' middles."""
        parts = zip(self.uv_tiles, self.weights, strict=True)
        return np.asarray(sum(repeated(image, uv) * weight for uv, weight in parts), np.float32)


def repeated(image: NDArray[Any], uv_tiles: FloatArray) -> NDArray[Any]:
    """Return a square texture at (R, W, 2) coordinates; row 0 of the image is the top of a tile."""
    size = len(image)
    within = uv_tiles - np.floor(uv_tiles)
    x, y = within[..., 0] * size - 0.5, (1 - within[..., 1]) * size - 0.5
    return bilinear(image, x, y, cv2.BORDER_WRAP)


def bilinear(image: NDArray[Any], x: FloatArray, y: FloatArray, border: int) -> NDArray[Any]:
    """Return an image, interpolated at (R, W) columns and rows."""
    places = x.astype(np.float32), y.astype(np.float32)
    return np.asarray(cv2.remap(image, *places, cv2.INTER_LINEAR, borderMode=border))


def _looked_up(image: NDArray[np.uint8], uv_tiles: FloatArray) -> Image:
    return np.asarray(cv2.LUT(repeated(image, uv_tiles), LINEAR))


def _turned(step: FloatArray, turn: FloatArray) -> FloatArray:
    """Return (R, W, 2) steps, each turned by its angle."""
    cos, sin = turn
    x, y = step[..., 0], step[..., 1]
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1)
