"""What the ground is made of: texture sets, the layers they make up, and where each layer lies.

Everything is in ``map`` (metres, z up). Nothing here draws random numbers or renders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.types import FloatArray


@dataclass(frozen=True)
class PbrMaps:
    """One tileable texture set, all maps square and of one size.

    Attributes:
        name: For messages and caches.
        color_srgb: (N, N, 3) uint8, sRGB-encoded albedo; row 0 is the top of the image.
        height: (N, N) float32, 0 to 1.
        normal_gl: (N, N, 3) uint8, tangent-space normals in OpenGL's convention (green up).
        roughness: (N, N) uint8, linear.
        tile_m: Edge length of one tile in metres.
    """

    name: str
    color_srgb: NDArray[np.uint8]
    height: NDArray[np.float32]
    normal_gl: NDArray[np.uint8]
    roughness: NDArray[np.uint8]
    tile_m: float


@dataclass(frozen=True)
class TerrainLayer:
    """A texture set on the ground together with the labels its surface carries, by level."""

    label: str
    semantic_ids: tuple[int, ...]
    maps: PbrMaps


@dataclass(frozen=True)
class TerrainMaterial:
    """Layers of the ground, blended by one weight mask per layer.

    Attributes:
        layers: At least one.
        masks: (L, M, M) float32 weights over the extent, texels at the centres of an M x M grid;
            row 0 at min_y, column 0 at min_x. They sum to 1.
        extent_m: (min_x, min_y, max_x, max_y) the masks cover.
    """

    layers: tuple[TerrainLayer, ...]
    masks: NDArray[np.float32]
    extent_m: tuple[float, float, float, float]

    def weights_at(self, xy_m: ArrayLike) -> FloatArray:
        """Return (N, L) bilinearly interpolated weights at (N, 2) points, clamped at the border."""
        xy = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
        x0, y0, x1, y1 = self.extent_m
        size = self.masks.shape[1]
        texel = (xy - (x0, y0)) / (x1 - x0, y1 - y0) * size - 0.5
        texel = np.clip(texel, 0, size - 1)
        low = np.minimum(np.floor(texel), size - 2).astype(np.intp)
        s, t = (texel - low).T
        flat = self.masks.reshape(len(self.masks), -1)
        index = low[:, 1] * size + low[:, 0]
        # One gather per corner: several times faster than indexing rows and columns.
        m00, m10, m01, m11 = (
            flat.take(index + step, axis=1).astype(np.float64) for step in (0, 1, size, size + 1)
        )
        return np.asarray((m00 * (1 - s) + m10 * s) * (1 - t) + (m01 * (1 - s) + m11 * s) * t).T

    def winning_layer(self, xy_m: ArrayLike) -> NDArray[np.intp]:
        """Return (N,) index of the heaviest layer at (N, 2) points; the first one wins a tie."""
        return np.asarray(np.argmax(self.weights_at(xy_m), axis=1), dtype=np.intp)

    def semantic_ids_at(self, xy_m: ArrayLike, level: int = 0) -> NDArray[np.uint16]:
        """Return (N,) uint16 label ids at (N, 2) points: those of the winning layers."""
        ids = np.array([id_of_level(la.semantic_ids, level) for la in self.layers], np.uint16)
        return np.asarray(ids[self.winning_layer(xy_m)])


def id_of_level(semantic_ids: Sequence[int], level: int) -> int:
    """Return the id of a level, 0 where the ids do not reach that far."""
    return semantic_ids[level] if level < len(semantic_ids) else 0
