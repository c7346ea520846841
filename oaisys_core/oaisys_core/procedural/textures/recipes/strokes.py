"""Thousands of ribbons on a tile, for blades, leaves and twigs; the highest one is visible.

A ribbon is a bent strip that tapers, rises and falls. Ribbons are sampled densely, and each pixel
keeps the highest sample, as in a depth buffer for a view from above.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.types import FloatArray

SAMPLES_AT_ONCE = 1_500_000
STEP_PX = 0.7
"""Distance between samples, less than a pixel so that ribbons have no holes."""

HEIGHT_BITS, SHARE_BITS = 20, 8
"""Bits of a pixel's key: height, ribbon index + 1, position along and across the ribbon."""

Profile = Callable[[NDArray[np.float32]], NDArray[np.float32]]


class Ribbons(NamedTuple):
    """A set of ribbons, with one value per ribbon in each field except the profiles.

    Attributes:
        root: (R, 2) row and column of the foot, in pixels.
        heading: (R,) radians, from columns towards rows.
        length: (R,) pixels, as seen from above.
        width: (R,) pixels at the widest.
        bend: (R,) sideways deviation of the tip, relative to the length.
        low: (R,) height of the foot, in pixels.
        rise: (R,) height of the highest point above the foot, in pixels.
        outline: Function of the position along the ribbon (0 to 1): half width, 0 to 1.
        arch: Function of the position along the ribbon (0 to 1): height, 0 to 1.
        curl: Height of the edges above the middle, relative to the width; may be negative.
    """

    root: FloatArray
    heading: FloatArray
    length: FloatArray
    width: FloatArray
    bend: FloatArray
    low: FloatArray
    rise: FloatArray
    outline: Profile
    arch: Profile
    curl: float = 0.0


def blade(t: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the outline of a blade of grass: nearly even, then a point."""
    return np.asarray(np.sqrt(1 - t**2.5) * (0.75 + 0.25 * t), np.float32)


def leaf(t: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the outline of a broad leaf: a stalk, a belly, a tip."""
    belly = np.sin(np.pi * np.clip((t - 0.1) / 0.9, 0, 1) ** 0.8)
    return np.asarray(np.maximum(belly, 0.0) ** 0.9 + 0.05 * (t < 0.12), np.float32)


def arc(t: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the height of a blade that rises and bends over."""
    return np.asarray(np.sin(2.2 * t), np.float32)


def level(t: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the height of a flat ribbon."""
    return np.ones_like(t)


class RibbonLayer:
    """A tile on which ribbons are laid; its properties describe the ribbon on top of each pixel.

    Attributes:
        count: Number of ribbons so far.
    """

    def __init__(self, size_px: int, highest_px: float) -> None:
        """Start with bare ground; no ribbon may rise above ``highest_px`` or below 0."""
        self._key = np.zeros((size_px, size_px), np.int64)
        self._highest_px = highest_px
        self.count = 0

    def lay(self, ribbons: Ribbons) -> None:
        """Add ribbons."""
        # Sample ribbons of similar length together.
        order = np.argsort(ribbons.length)
        first = 0
        while first < len(order):
            width = max(1, int(np.ceil(ribbons.width.max() / STEP_PX)))
            length = float(ribbons.length[order[first]])
            last = int(np.searchsorted(ribbons.length[order], 1.3 * length + 2, side="right"))
            along = max(2, int(np.ceil(ribbons.length[order[last - 1]] / STEP_PX)))
            last = min(last, first + max(1, SAMPLES_AT_ONCE // (along * width)))
            self._sample(ribbons, order[first:last], along, width)
            first = last
        self.count += len(order)

    def _sample(self, r: Ribbons, part: NDArray[np.intp], along: int, across: int) -> None:
        size_px = len(self._key)
        t = ((np.arange(along, dtype=np.float32) + 0.5) / along)[None, :, None]
        s = ((np.arange(across, dtype=np.float32) + 0.5) / across * 2 - 1)[None, None, :]
        root, heading, length, width, bend, low, rise = (
            np.asarray(v[part], np.float32)[..., None, None] for v in r[:7]
        )
        cos, sin = np.cos(heading), np.sin(heading)
        forward = length * t
        sideways = length * bend * t**2 + 0.5 * width * r.outline(t) * s
        row = root[:, 0] + sin * forward + cos * sideways
        column = root[:, 1] + cos * forward - sin * sideways
        z = low + rise * r.arch(t) + np.float32(r.curl) * width * (s**2 - 0.5)
        level = np.clip(z / np.float32(self._highest_px), 0, 1) * ((1 << HEIGHT_BITS) - 1)
        key = level.astype(np.int64) << (64 - HEIGHT_BITS - 1)
        number = np.asarray(part + self.count + 1, np.int64)[:, None, None]
        key |= number << (2 * SHARE_BITS)
        key |= (t * 255).astype(np.int64) << SHARE_BITS
        key |= ((s * 0.5 + 0.5) * 255).astype(np.int64)
        row_px = np.floor(row).astype(np.int64) % size_px
        column_px = np.floor(column).astype(np.int64) % size_px
        np.maximum.at(self._key.ravel(), (row_px * size_px + column_px).ravel(), key.ravel())

    @property
    def ids(self) -> NDArray[np.int64]:
        """(N, N) index of the ribbon on top, -1 on bare ground."""
        bits = 64 - HEIGHT_BITS - 1 - 2 * SHARE_BITS
        return ((self._key >> (2 * SHARE_BITS)) & ((1 << bits) - 1)) - 1

    @property
    def height_px(self) -> Field:
        """(N, N) height of the ribbon on top, 0 on bare ground."""
        share = (self._key >> (64 - HEIGHT_BITS - 1)) / ((1 << HEIGHT_BITS) - 1)
        return np.asarray(share * self._highest_px, np.float32)

    @property
    def along(self) -> Field:
        """(N, N) position along the ribbon on top, 0 at its foot to 1 at its tip."""
        return np.asarray(((self._key >> SHARE_BITS) & 255) / 255, np.float32)

    @property
    def across(self) -> Field:
        """(N, N) position across the ribbon on top, -1 to 1."""
        return np.asarray((self._key & 255) / 127.5 - 1, np.float32)
