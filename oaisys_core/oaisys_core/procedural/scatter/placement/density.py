"""Densities of scattered objects: noise, cells, slopes, heights, moisture, layers and images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.config.sections.density import (
    DensityConfig,
    HeightDensity,
    ImageDensity,
    LayerDensity,
    MoistureDensity,
    NoiseDensity,
    SlopeDensity,
    VoronoiDensity,
)
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_use import DENSITY
from oaisys_core.files.image_formats.images import read_pixels
from oaisys_core.procedural.scatter.placement.random_poses import log_gaussian, slope_deg
from oaisys_core.procedural.terrain.noise import Field, spectral
from oaisys_core.procedural.terrain.water.moisture import moisture
from oaisys_core.scene import Ground
from oaisys_core.scene.terrain_material import TerrainMaterial
from oaisys_core.types import FloatArray

Density = Callable[[FloatArray], FloatArray]
"""Returns (N,) values from 0 to 1 at (N, 2) points in ``map``."""

NOISE_ROUGH = 1.8
"""Exponent by which noise amplitudes fall with frequency; lower gives more ragged patches."""

CLUMP_SIZES = 2.0, 24.0
"""Shortest and longest waves of the noise by which plants clump, in units of their size."""

CLUMPED, DENSEST = 1.4, 2.0
"""Standard deviation of the logarithm of the density of clumps, and where it ends, in the same."""

CLUMPS_PX = 64, 1024
"""Least and largest size of the map of clumps."""

RELIEF_POINTS = 257
"""Points along an edge of the ground at which its height range is sampled."""


def make_density(
    configs: Sequence[DensityConfig],
    ground: Ground,
    rng: np.random.Generator,
    material: TerrainMaterial | None = None,
) -> Density:
    """Return the product of several densities over a ground.

    Args:
        configs: Of the densities.
        ground: What the objects stand on.
        rng: Seeds the densities; each has its own stream, by its index.
        material: Of the ground; None if there is none, nor a density of a layer.

    Raises:
        InvalidInputError: An image cannot be read.
    """
    parts = [
        _density(config, ground, randomness.child(rng, f"density/{index}"), material)
        for index, config in enumerate(configs)
    ]

    def product(xy: FloatArray) -> FloatArray:
        total = np.ones(len(xy))
        for config, part in zip(configs, parts, strict=True):
            total *= config.least + (1 - config.least) * part(xy)
        return total

    return product


def _density(
    config: DensityConfig,
    ground: Ground,
    rng: np.random.Generator,
    material: TerrainMaterial | None,
) -> Density:
    if isinstance(config, NoiseDensity):
        return partial(bilinear, _noise_patches(config, ground, rng), ground)
    if isinstance(config, VoronoiDensity):
        return _cells(config, ground, rng)
    if isinstance(config, SlopeDensity):
        low, high = config.range_deg
        return lambda xy: band(slope_deg(ground, xy), low, high, config.fade_deg)
    if isinstance(config, HeightDensity):
        low, high = _height_range_m(config, ground)
        return lambda xy: band(ground.height_at(xy), low, high, config.fade_m)
    if isinstance(config, MoistureDensity):
        low, high = config.range_share
        wet = moisture(ground)
        # The wettest and the driest places are inside of bounds of 1 and 0.
        low, high = (low if low > 0 else -np.inf), (high if high < 1 else np.inf)
        return lambda xy: band(bilinear(wet, ground, xy), low, high, config.fade_share)
    if isinstance(config, LayerDensity):
        return _layer(config.labels, material)
    return partial(bilinear, _image(config), ground)


def in_clumps(density: Density, size_m: float, ground: Ground, rng: np.random.Generator) -> Density:
    """Return a density of plants that stand in clumps, with some alone between them.

    Seeds fall near their plants and shoots grow beside them, see `log_gaussian`.

    Args:
        density: How many there are on average.
        size_m: Their size.
        ground: What they stand on.
        rng: Draws the clumps.
    """
    x0, y0, x1, y1 = ground.extent_m
    extent_m = max(x1 - x0, y1 - y0)
    highest, lowest = (max(extent_m / (each * size_m), 1.0) for each in CLUMP_SIZES)
    least_px, most_px = CLUMPS_PX
    size_px = int(np.clip(2 ** np.ceil(np.log2(4 * highest)), least_px, most_px))
    share = log_gaussian(size_px, lowest, highest, CLUMPED, DENSEST, rng)
    return lambda xy: density(xy) * bilinear(share, ground, xy)


def band(values: FloatArray, low: float, high: float, fade: float) -> FloatArray:
    """Return 1 from ``low`` to ``high`` and 0 outside and at NaN, with linear fades at both bounds.

    >>> band(np.array([0.0, 1.0, 1.5, 4.0]), 1.0, 3.0, 1.0)
    array([0. , 0.5, 1. , 0. ])
    """
    inside = np.minimum(values - low, high - values)
    share = (inside >= 0).astype(float) if fade == 0 else np.clip(inside / fade + 0.5, 0, 1)
    return np.asarray(np.nan_to_num(share))


def draw_texels(
    cumulative: FloatArray, columns: int, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]:
    """Return texels that are drawn by their weights, and places in them.

    Args:
        cumulative: (rows * columns,) sums of the weights up to each texel; the last is not 0.
        columns: Texels in a row.
        count: Number of places.
        rng: Draws them.

    Returns:
        (count,) rows and (count,) columns, and (count, 2) places along x and y, in texels.
    """
    chosen = np.searchsorted(cumulative, rng.uniform(size=count) * cumulative[-1], side="right")
    row, column = np.divmod(np.minimum(chosen, len(cumulative) - 1), columns)
    return row, column, np.column_stack((column, row)) + rng.uniform(size=(count, 2))


def bilinear(field: Field | FloatArray, ground: Ground, xy: FloatArray) -> FloatArray:
    """Return (N,) interpolated values of a field over the ground, with row 0 at the smallest y."""
    x0, y0, x1, y1 = ground.extent_m
    rows, cols = field.shape
    place = (xy - (x0, y0)) / (x1 - x0, y1 - y0) * (cols, rows) - 0.5
    place = np.clip(place, 0, (cols - 1, rows - 1))
    low = np.minimum(place.astype(np.intp), np.maximum((cols - 2, rows - 2), 0))
    (s, t), (column, row) = (place - low).T, low.T
    right, above = np.minimum(column + 1, cols - 1), np.minimum(row + 1, rows - 1)
    lower = field[row, column] * (1 - s) + field[row, right] * s
    upper = field[above, column] * (1 - s) + field[above, right] * s
    return np.asarray(lower * (1 - t) + upper * t, np.float64)


def _noise_patches(config: NoiseDensity, ground: Ground, rng: np.random.Generator) -> Field:
    x0, y0, x1, y1 = ground.extent_m
    waves = max(max(x1 - x0, y1 - y0) / (2 * config.scale_m), 1.0)
    size_px = int(np.clip(2 ** np.ceil(np.log2(16 * waves)), 64, 1024))
    field = spectral(size_px, waves, rng, NOISE_ROUGH)
    if config.cover in (0.0, 1.0):
        return np.full_like(field, config.cover)
    border = np.quantile(field, 1 - config.cover)
    return np.asarray(np.clip((field - border) / max(2 * config.softness, 1e-6) + 0.5, 0, 1))


def _cells(config: VoronoiDensity, ground: Ground, rng: np.random.Generator) -> Density:
    x0, y0, x1, y1 = ground.extent_m
    # Points beyond the rim keep the cells at the rim as wide as the others.
    low, high = np.array((x0, y0)) - config.cell_m, np.array((x1, y1)) + config.cell_m
    count = max(2, round(float(np.prod(high - low)) / config.cell_m**2))
    tree = scipy.spatial.cKDTree(rng.uniform(low, high, (count, 2)))
    holds = np.zeros(count)
    holds[rng.permutation(count)[: round(config.cover * count)]] = 1

    def density(xy: FloatArray) -> FloatArray:
        distance_m, cell = tree.query(xy, k=2)
        if config.border_m == 0:
            return np.asarray(holds[cell[:, 0]])
        inside_m = (distance_m[:, 1] - distance_m[:, 0]) / 2
        return np.asarray(holds[cell[:, 0]] * np.clip(inside_m / config.border_m, 0, 1))

    return density


def _layer(labels: tuple[str, ...], material: TerrainMaterial | None) -> Density:
    if material is None:
        raise ValueError("a density of a layer needs a material")
    chosen = [layer.label in labels for layer in material.layers]
    return lambda xy: np.minimum(material.weights_at(xy)[:, chosen].sum(axis=1), 1.0)


def _height_range_m(config: HeightDensity, ground: Ground) -> tuple[float, float]:
    if config.range_m is not None:
        return config.range_m
    x0, y0, x1, y1 = ground.extent_m
    x, y = np.meshgrid(np.linspace(x0, x1, RELIEF_POINTS), np.linspace(y0, y1, RELIEF_POINTS))
    heights_m = ground.height_at(np.column_stack((x.ravel(), y.ravel())))
    low, relief = np.nanmin(heights_m), np.ptp(heights_m[np.isfinite(heights_m)])
    return float(low + config.range_share[0] * relief), float(low + config.range_share[1] * relief)


def _image(config: ImageDensity) -> Field:
    import cv2

    grey = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE
    pixels = read_pixels(config.file, DENSITY, grey)
    if pixels.dtype not in (np.uint8, np.uint16):
        expected = f"a grey image of 8 or 16 bits, not of {pixels.dtype}"
        raise InvalidInputError("density.file", str(config.file), expected)
    share = pixels[::-1].astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    return np.asarray(1 - share if config.invert else share)
