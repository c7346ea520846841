"""Weights of the ground's layers on the land around a stage: patches of many sizes, as in nature.

They are stored over direction and logarithm of the distance, so that one image of moderate size
reaches from the stage's edge to the horizon, with cells that grow with the distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import ceil, log, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.terrain.masks.cover import (
    WAVES_M,
    cover_softness,
    tuft_deviation,
    tufts,
)
from oaisys_core.procedural.terrain.masks.patches import NOWHERE, PATCHES, RAGGED, weights_of
from oaisys_core.procedural.terrain.noise import Field, balancing_offsets, filter_noise
from oaisys_core.procedural.terrain.surroundings.land_relief import LandScores
from oaisys_core.types import FloatArray

DIRECTIONS = 1280
"""Columns of the masks: 0.28 degrees each, as seen from the stage's centre."""

FARTHEST_M, FARTHEST_SHARE = 30_000.0, 8.0
"""Distance up to which there are rows, in metres and in units of the nearest row's; the greater of
the two. Within the last e-fold, patches give way to the layers' shares, which go on beyond it."""

PATCHES_PX, PATCHES_TEXEL = 1024, 0.5
"""Size of the tile of large patches, and of its texels in units of the stage's patches."""

RAGGED_PX, RAGGED_TEXEL = 512, 1 / 32
"""The same of the tile that makes the patches' borders ragged."""

TUFTS_PX, TUFTS_TEXEL_M = 512, WAVES_M[0] / 2
"""Size of the tile of tufts of plants, and of its texels."""

SPREAD, RAGGED_SPREAD = 1.7, 0.83
"""Standard deviations of the tiles, in units of that of the stage's patches: every octave is as
strong as on the stage."""

FALL, RAGGED_FALL = 1.0, RAGGED
"""Exponents by which amplitudes fall with frequency. With 1, every octave has the same variance."""

MIN_SHARE = 1e-4
"""Layers of a smaller share of the stage do not lie on the land."""

STRIDE = 8
"""Of the cells from which the shares of layers are balanced."""


@dataclass(frozen=True, eq=False)
class PatchyLandMasks:
    """Weights of layers around a stage, with the same shares of the ground as on the stage.

    Attributes:
        extent_m: (min_x, min_y, max_x, max_y) of the stage.
        shares: Shares of the stage that its layers cover.
        patch_m: Size of the stage's patches. On the land there are larger ones, too.
        softness: Width of the borders of patches, in standard deviations of the stage's patches.
        seed: Seed of the patches.
        relief: Relief of the land, which the patches follow; None for patches of noise alone.
        is_green: Whether each layer is of plants, which thin out to tufts; empty for none.
        sharpness: Sharpness of the borders of plants and snow, see `tuft_softness`.
        is_snowy: Whether each layer is of snow; empty for none.
    """

    extent_m: tuple[float, float, float, float]
    shares: tuple[float, ...]
    patch_m: float
    softness: float
    seed: int
    relief: LandScores | None = None
    is_green: tuple[bool, ...] = ()
    sharpness: float = 1.0
    is_snowy: tuple[bool, ...] = ()

    @property
    def centre_m(self) -> tuple[float, float]:
        """Centre of the stage."""
        x0, y0, x1, y1 = self.extent_m
        return (x0 + x1) / 2, (y0 + y1) / 2

    @property
    def half_m(self) -> tuple[float, float]:
        """Distances of the stage's edges from its centre, in x and in y."""
        x0, y0, x1, y1 = self.extent_m
        return (x1 - x0) / 2, (y1 - y0) / 2

    @property
    def nearest_m(self) -> float:
        """Distance of the first row from the stage's centre."""
        return min(self.half_m)

    @property
    def rows_per_e_fold(self) -> float:
        """Rows within which the distance grows by a factor of e: cells are square."""
        return DIRECTIONS / (2 * pi)

    @property
    def rows(self) -> int:
        """Number of rows."""
        farthest = farthest_m(self.nearest_m) / self.nearest_m
        return ceil(log(farthest) * self.rows_per_e_fold) + 1

    def texels_at(self, xy_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return columns and rows, as fractions, at (..., 2) points; columns wrap around."""
        x, y = xy_m[..., 0] - self.centre_m[0], xy_m[..., 1] - self.centre_m[1]
        columns = np.arctan2(y, x) * (DIRECTIONS / (2 * pi)) - 0.5
        distance_m = np.maximum(np.hypot(x, y), self.nearest_m)
        rows = np.log(distance_m / self.nearest_m) * self.rows_per_e_fold
        return np.mod(columns, DIRECTIONS), np.minimum(rows, self.rows - 1.0)

    def share_at(self, xy_m: FloatArray) -> FloatArray:
        """Return (...) weights of these masks over the stage's, mirrored, at (..., 2) points.

        They grow from 0 on the stage to 1 at a distance of a patch.
        """
        outside_m = np.maximum(np.abs(xy_m - self.centre_m) - self.half_m, 0.0)
        distance_m = np.hypot(outside_m[..., 0], outside_m[..., 1])
        return np.asarray(np.minimum(distance_m / self.patch_m, 1.0))

    def blend(self, xy_m: FloatArray, weights: FloatArray) -> FloatArray:
        """Return (N, L) weights at (N, 2) points; ``weights`` are those of the stage's masks."""
        if not self._is_any_beyond(xy_m):
            return weights
        share = self.share_at(xy_m)
        beyond = np.flatnonzero(share)
        if not len(beyond):
            return weights
        result = weights.copy()
        t = share[beyond, None]
        result[beyond] = weights[beyond] * (1 - t) + self._interpolate(xy_m[beyond]) * t
        return result

    def _is_any_beyond(self, xy_m: FloatArray) -> bool:
        """Return whether any of (N, 2) points is not on the stage."""
        away_m = (np.abs(xy_m[:, axis] - self.centre_m[axis]) for axis in range(2))
        return any((each > most).any() for each, most in zip(away_m, self.half_m, strict=True))

    def _interpolate(self, xy_m: FloatArray) -> FloatArray:
        columns, rows = self.texels_at(xy_m)
        left, low = columns.astype(np.intp), np.minimum(rows.astype(np.intp), self.rows - 2)
        s, t = columns - left, rows - low
        left, right = left % DIRECTIONS, (left + 1) % DIRECTIONS
        lower = self.weights[:, low, left] * (1 - s) + self.weights[:, low, right] * s
        upper = self.weights[:, low + 1, left] * (1 - s) + self.weights[:, low + 1, right] * s
        return np.asarray(lower * (1 - t) + upper * t).T

    @cached_property
    def weights(self) -> NDArray[np.float32]:
        """(L, rows, DIRECTIONS) float32 weights that sum to 1."""
        count = len(self.shares)
        # Without noise of its own, the first layer lies where the others have little.
        scores = np.zeros((count, self.rows, DIRECTIONS), np.float32)
        green, snowy = (
            np.array(each or (False,) * count) for each in (self.is_green, self.is_snowy)
        )
        for tiles in self._tiles():
            self._add(tiles, list(scores[1:]))
        if green.any():
            of_plants = [scores[each] for each in np.flatnonzero(green)]
            self._add(self._tufts(len(of_plants)), of_plants)
        if self.relief is not None:
            for layer in range(count):
                scores[layer] += self.relief.scores(layer, scores.shape[1:])
        shares = np.maximum(np.array(self.shares), MIN_SHARE)
        scores += balancing_offsets(scores[:, ::STRIDE, ::STRIDE], shares)[:, None, None]
        scores[np.array(self.shares) < MIN_SHARE] = NOWHERE
        narrow = cover_softness(self.sharpness, self._cells_m, bool(green.any()))[:, None]
        weights = weights_of(scores, self.softness, green | snowy, narrow)
        mean = np.array(self.shares, np.float32)[:, None, None]
        weights += (mean / mean.sum() - weights) * self._fade()[:, None]
        return weights

    def _fade(self) -> Field:
        """Return the (rows,) weights of the layers' shares over their patches."""
        left = self.rows - 1 - np.arange(self.rows)
        return np.maximum(1 - left / self.rows_per_e_fold, 0).astype(np.float32)

    def _tiles(self) -> Iterator[Tiles]:
        """Yield the noise by which all layers but the first compete for the ground."""
        rng = randomness.stream(self.seed, "land_masks")
        # Waves that the second kind of tiles has, too, are left to it.
        lowest = RAGGED_PX * RAGGED_TEXEL
        for size, texel, fall, spread in (
            (PATCHES_PX, PATCHES_TEXEL, _fall(PATCHES_PX, 1.0, FALL), SPREAD),
            (RAGGED_PX, RAGGED_TEXEL, _fall(RAGGED_PX, lowest, RAGGED_FALL), RAGGED_SPREAD),
        ):
            noises = [filter_noise(size, fall, rng) for _ in self.shares[1:]]
            start, turn_rad = rng.uniform(0, size, 2), rng.uniform(0, 2 * pi)
            scaled = [noise * np.float32(PATCHES * spread) for noise in noises]
            yield Tiles(scaled, texel * self.patch_m, (start[0], start[1]), turn_rad)

    def _tufts(self, count: int) -> Tiles:
        """Return the noise of the tufts of a number of layers of plants."""
        rng = randomness.stream(self.seed, "land_tufts")
        deviation = np.float32(tuft_deviation(self.sharpness))
        noises = [deviation * tufts(TUFTS_PX, TUFTS_TEXEL_M, rng) for _ in range(count)]
        start, turn_rad = rng.uniform(0, TUFTS_PX, 2), rng.uniform(0, 2 * pi)
        return Tiles(noises, TUFTS_TEXEL_M, (start[0], start[1]), turn_rad)

    @property
    def _distances_m(self) -> FloatArray:
        """(rows,) distances from the stage's centre."""
        return np.asarray(self.nearest_m * np.exp(np.arange(self.rows) / self.rows_per_e_fold))

    @property
    def _cells_m(self) -> FloatArray:
        """(rows,) sizes of cells."""
        return self._distances_m / self.rows_per_e_fold

    def _add(self, tiles: Tiles, scores: list[Field]) -> None:
        """Add copies of tiles to the (rows, DIRECTIONS) scores of as many layers.

        They are averaged over cells that are larger than their texels.
        """
        import cv2

        angle = (np.arange(DIRECTIONS) + 0.5) * (2 * pi / DIRECTIONS) + tiles.turn_rad
        cos, sin = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
        reach = (self._distances_m / tiles.texel_m).astype(np.float32)
        cell = np.maximum(reach / self.rows_per_e_fold, 1e-9)
        level = np.maximum(np.ceil(np.log2(cell)), 0).astype(np.intp)
        whole = len(tiles.noises[0])
        for each in np.unique(level):
            size = whole >> int(each)
            if size < 2:
                continue
            rows = slice(*np.searchsorted(level, (each, each + 1)))
            # Iso-lines of linearly interpolated noise have corners.
            way = cv2.INTER_CUBIC if each == 0 else cv2.INTER_LINEAR
            x, y = (
                _wrap(reach[rows, None] * along + np.float32(start), whole, size)
                for along, start in zip((cos, sin), tiles.start, strict=True)
            )
            for noise, score in zip(tiles.noises, scores, strict=True):
                smaller = np.asarray(cv2.resize(noise, (size, size), interpolation=cv2.INTER_AREA))
                score[rows] += cv2.remap(smaller, x, y, way, borderMode=cv2.BORDER_WRAP)


def farthest_m(nearest_m: float) -> float:
    """Return the distance of the last row of masks whose first row is at a distance."""
    return max(FARTHEST_M, FARTHEST_SHARE * nearest_m)


class Tiles(NamedTuple):
    """Noise that is laid on the land in copies.

    Attributes:
        noises: (N, N) scores of each layer but the first.
        texel_m: Size of a texel.
        start: Texels at the stage's centre.
        turn_rad: Direction of the rows.
    """

    noises: list[Field]
    texel_m: float
    start: tuple[float, float]
    turn_rad: float


def _wrap(texels: Field, whole: int, size: int) -> Field:
    """Return places in a tile of ``size`` texels; ``texels`` are of one of ``whole`` texels."""
    tiles = texels * np.float32(1 / whole)
    tiles -= np.floor(tiles)
    tiles *= np.float32(size)
    tiles -= np.float32(0.5)
    return tiles


def _fall(size: int, lowest: float, exponent: float) -> Field:
    """Return amplitudes by frequency that fall from ``lowest`` on, and are 0 below."""
    frequency = np.hypot(
        np.fft.fftfreq(size, 1 / size)[:, None], np.fft.rfftfreq(size, 1 / size)[None, :]
    )
    gain = np.maximum(frequency / lowest, 1e-9) ** -exponent
    gain[frequency < lowest] = 0
    return np.asarray(gain, np.float32)
