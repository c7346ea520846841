"""Single things on a tile: where they lie, and their heights over the texels around them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.textures.baking.stamps import OUTSIDE
from oaisys_core.types import FloatArray


class Placements(NamedTuple):
    """Where things lie: one value for each.

    Attributes:
        centre: (P, 2) row and column in texels.
        radius_px: (P,) half of the diameter.
        heading: (P,) radians, from columns towards the top of the tile.
        shape: (P,) number of the stamp.
        buried: (P,) share of the height below the ground.
    """

    centre: FloatArray
    radius_px: FloatArray
    heading: FloatArray
    shape: NDArray[np.int64]
    buried: FloatArray

    def at(self, which: slice | NDArray[np.intp]) -> Placements:
        """Return some of them."""
        parts: Any = (each[which] for each in self)
        return Placements(*parts)


def turn_stamp(image: NDArray[np.float32], placed: Placements, half: int) -> NDArray[np.float32]:
    """Return the (W, W) heights of a stamp around the texel that its centre is in.

    OpenCV's versions round such coordinates in ways of their own; this is the same everywhere.
    """
    (row, column), radius = placed.centre[0], float(placed.radius_px[0])
    edge, middle = len(image), np.float32(len(image) / 2 - 0.5)
    per_px = edge / (2 * radius)
    cos, sin = (np.float32(f(placed.heading[0]) * per_px) for f in (np.cos, np.sin))
    # Places of texels' centres, relative to the thing's.
    offset = np.arange(-half, half + 1) + 0.5
    right = (offset + (np.floor(column) - column)).astype(np.float32)[None, :]
    down = (offset + (np.floor(row) - row)).astype(np.float32)[:, None]
    x, y = cos * right - sin * down + middle, sin * right + cos * down + middle
    is_in = (x >= 0) & (x < edge - 1) & (y >= 0) & (y < edge - 1)
    x, y = x.clip(0, edge - 1.001), y.clip(0, edge - 1.001)
    first_x, first_y = x.astype(np.int32), y.astype(np.int32)
    x -= first_x
    y -= first_y
    flat, of_texel = image.ravel(), first_y * edge + first_x
    upper, lower = (
        flat[each] + x * (flat[each + 1] - flat[each]) for each in (of_texel, of_texel + edge)
    )
    return np.where(is_in, upper + y * (lower - upper), np.float32(OUTSIDE))


def leaning(ground: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the (W, W) heights of the plane through (W, W) ground, 0 in the middle."""
    half = len(ground) // 2
    axis = np.arange(-half, half + 1, dtype=np.float32)
    count = float(inside.sum())
    parts = []
    for offset in (axis[:, None], axis[None, :]):
        place = np.where(inside, offset, 0)
        place = place - inside * np.float32(place.sum() / count)
        slope = float((place * ground).sum() / max(float((place**2).sum()), 1e-9))
        parts.append(np.float32(slope) * offset)
    return np.asarray(parts[0] + parts[1], np.float32)


def above_ground(
    z: NDArray[np.float32],
    mean: FloatArray | float,
    base: FloatArray | float,
    top: FloatArray | float,
) -> NDArray[np.float32]:
    """Return how far heights are above the ground, relative to the top of what rises from it."""
    rise = np.maximum(base + np.asarray(top) - mean, 1e-9)
    return np.asarray(np.clip((z - mean) / rise, 0, 1), np.float32)
