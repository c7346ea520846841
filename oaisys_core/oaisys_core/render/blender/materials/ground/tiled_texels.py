"""Texels of the ground as tilings lay them, at several points of each pixel.

Where the texture's copies are is computed once for each pixel: it is the same all over a pixel, but
at the seams of a tiling, where the weights of what changes are next to nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.scene.tiling import Tiling
from oaisys_core.types import FloatArray

Image = NDArray[np.float32]


class PixelLookups(NamedTuple):
    """The K texture lookups that are blended in each of (R, W) pixels.

    Attributes:
        uv_tiles: (K, R, W, 2) texture coordinates of the pixels' centres.
        weights: (K, R, W) weights, which sum to 1.
        turn: (2, R, W) cosine and sine of the angle by which the first is turned; None: by none.
    """

    uv_tiles: FloatArray
    weights: Image
    turn: FloatArray | None

    def beside(self, step_tiles: FloatArray) -> list[FloatArray]:
        """Return K (R, W, 2) texture coordinates, (R, W, 2) steps away from the centres."""
        if self.turn is None:
            return [each + step_tiles for each in self.uv_tiles]
        cos, sin = self.turn
        x, y = step_tiles[..., 0], step_tiles[..., 1]
        turned = np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1)
        first, *others = self.uv_tiles
        return [first + turned, *(each + step_tiles for each in others)]


def pixel_lookups(tiling: Tiling, uv_tiles: FloatArray) -> PixelLookups:
    """Return where pixels with centres at (R, W, 2) coordinates look a texture up."""
    shape = uv_tiles.shape[:2]
    found = tiling.samples(uv_tiles.reshape(-1, 2))
    weights = found.weights.reshape(-1, *shape).astype(np.float32)
    turn = None if found.turn is None else found.turn.reshape(2, *shape)
    return PixelLookups(found.uv_tiles.reshape(-1, *shape, 2), weights, turn)
