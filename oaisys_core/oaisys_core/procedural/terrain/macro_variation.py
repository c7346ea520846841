"""Variation of the ground's colour from metres to kilometres, as by dust and dampness."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.terrain.noise import spectral
from oaisys_core.types import FloatArray

SIZE_PX, TEXEL_M = 1024, 2.0
"""Size of the pattern: it has waves from 4 m to 2 km, each octave with the same variance."""

BRIGHTNESS, TINT = 0.13, 0.04
"""Standard deviations at strength 1 of the brightness, and of red and, reversed, blue beside it."""

DUST = 0.6
"""Correlation of brightness and tint: dust is bright and warm, damp ground dark and cold."""

MIN_FACTOR, MAX_FACTOR = 0.5, 1.5
"""Bounds of the factor."""


@dataclass(frozen=True, eq=False)
class MacroPattern:
    """A factor on the ground's colour, on the stage and beyond, by the place in ``map``.

    Attributes:
        strength: Share of `BRIGHTNESS` and `TINT`.
        seed: Seed of the pattern.
    """

    strength: float
    seed: int

    @property
    def period_m(self) -> float:
        """Distance after which the pattern repeats."""
        return SIZE_PX * TEXEL_M

    @cached_property
    def share(self) -> NDArray[np.uint8]:
        """(SIZE_PX, SIZE_PX, 3) bytes: the factor's place between its bounds.

        Row 0 and column 0 begin at 0 m. The mean factor is 1.
        """
        rng = randomness.stream(self.seed, "macro_variation")
        bright = spectral(SIZE_PX, 1.0, rng, 1.0)
        # Far apart, the pattern is as independent of itself as of another.
        other = np.roll(bright, (SIZE_PX // 2, SIZE_PX // 3), axis=(0, 1))
        warm = np.float32(DUST) * bright + np.float32((1 - DUST**2) ** 0.5) * other
        share = np.empty((SIZE_PX, SIZE_PX, 3), np.uint8)
        for channel, tint in enumerate((TINT, 0.0, -TINT)):
            deviation = np.float32(self.strength * BRIGHTNESS) * bright
            deviation += np.float32(self.strength * tint) * warm
            factor = np.clip(1 + deviation, MIN_FACTOR, MAX_FACTOR)
            factor += 1 - factor.mean()
            bytes_of_factor = (factor - MIN_FACTOR) * np.float32(255 / (MAX_FACTOR - MIN_FACTOR))
            share[..., channel] = np.rint(np.clip(bytes_of_factor, 0, 255))
        return share

    def factors_at(self, xy_m: FloatArray) -> FloatArray:
        """Return (N, 3) factors on the linear colours at (N, 2) points."""
        column, row = (xy_m / TEXEL_M - 0.5).T
        channels = [
            scipy.ndimage.map_coordinates(
                channel, (row, column), np.float32, order=1, mode="grid-wrap"
            )
            for channel in np.moveaxis(self.share, -1, 0)
        ]
        return np.asarray(
            MIN_FACTOR + np.stack(channels, axis=-1) * ((MAX_FACTOR - MIN_FACTOR) / 255), np.float64
        )
