"""The relief of a stage by wavelength, continued to wavelengths that are longer than the stage."""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

import numpy as np

from oaisys_core.scene import Ground, HeightField
from oaisys_core.types import FloatArray

MAX_POINTS = 2049
"""Grids of more points along an edge are thinned out first."""

MESH_POINTS = 257
"""Points along an edge at which a stage that is no grid is sampled."""

MIN_BLOCKS = 4
"""Least number of blocks along an edge whose means say how high the stage's largest forms are."""

WAVELENGTH_BLOCKS = 3.0
"""Wavelength in blocks of what differs between the means of blocks and of blocks twice as large."""

MIN_STEEPNESS, MAX_STEEPNESS = 0.011, 0.015
"""Bounds of the standard deviation of heights of each longer octave over its wavelength: plains
are not level for kilometres, and no range darkens the stage when the sun is ten degrees high."""

MIN_EXPONENT, MAX_EXPONENT = 0.3, 0.9
"""Bounds of the exponent by which amplitudes grow with the wavelength beyond the stage's size."""

FITTED_OCTAVES = 4
"""Number of the stage's longest octaves from which this exponent is fitted."""


class Octave(NamedTuple):
    """The part of a relief with wavelengths within an octave.

    Attributes:
        wavelength_m: The wavelength in its middle.
        deviation_m: Standard deviation of its heights.
        share: Share of these heights that a land has, which a low sun is to reach.
    """

    wavelength_m: float
    deviation_m: float
    share: float = 1.0


def own_octaves(stage: Ground) -> list[Octave]:
    """Return the octaves of a stage's relief that are shorter than the stage, shortest first."""
    return _octaves_of(*_heights(stage))


def _heights(stage: Ground) -> tuple[FloatArray, float]:
    """Return a grid of heights without its mean slope, and its spacing."""
    if isinstance(stage, HeightField):
        step = ceil(max(stage.elevation_m.shape) / MAX_POINTS)
        height_m = stage.elevation_m[::step, ::step].astype(np.float64)
        spacing_m = stage.spacing_m * step
    else:
        x0, y0, x1, y1 = stage.extent_m
        spacing_m = max(x1 - x0, y1 - y0) / (MESH_POINTS - 1)
        x, y = np.meshgrid(np.arange(x0, x1, spacing_m), np.arange(y0, y1, spacing_m))
        height_m = stage.height_at(np.column_stack((x.ravel(), y.ravel()))).reshape(x.shape)
        is_known = np.isfinite(height_m)
        mean_m = height_m[is_known].mean() if is_known.any() else 0.0
        height_m = np.where(is_known, height_m, mean_m)
    height_m -= height_m.mean()
    for axis in (0, 1):
        place = np.arange(height_m.shape[axis]) - (height_m.shape[axis] - 1) / 2
        rise = place @ height_m.mean(axis=1 - axis) / max(place @ place, 1e-12)
        height_m -= rise * (place[:, None] if axis == 0 else place[None, :])
    return height_m, spacing_m


def _octaves_of(height_m: FloatArray, spacing_m: float) -> list[Octave]:
    """Return the octaves of a grid of heights.

    An octave is what means over blocks of twice the size, interpolated, do not explain. Unlike the
    means alone, interpolation explains slopes.
    """
    octaves: list[Octave] = []
    for axis in (0, 1):
        if height_m.shape[axis] == 1:  # a strip narrower than the spacing
            height_m = np.repeat(height_m, 2, axis=axis)
    while min(height_m.shape) >= 2 * MIN_BLOCKS or not octaves:
        rows, cols = (size // 2 * 2 for size in height_m.shape)
        blocks = height_m[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2)
        means_m = blocks.mean(axis=(1, 3))
        smooth_m = _interpolate(_interpolate(means_m, 0), 1)
        deviation_m = float((height_m[:rows, :cols] - smooth_m).std())
        octaves.append(Octave(WAVELENGTH_BLOCKS * spacing_m, deviation_m))
        height_m, spacing_m = means_m, 2 * spacing_m
    return octaves


def _interpolate(values: FloatArray, axis: int) -> FloatArray:
    """Return twice as many values along an axis, interpolated between the middles of cells."""
    along = np.moveaxis(values, axis, 0)
    if len(along) == 1:
        return np.repeat(values, 2, axis=axis)
    before = np.concatenate((2 * along[:1] - along[1:2], along[:-1]))
    after = np.concatenate((along[1:], 2 * along[-1:] - along[-2:-1]))
    both = np.stack((0.75 * along + 0.25 * before, 0.75 * along + 0.25 * after), axis=1)
    return np.moveaxis(both.reshape(-1, *along.shape[1:]), 0, axis)


def longer_octaves(own: list[Octave], longest_m: float) -> list[Octave]:
    """Return the octaves that follow those of a stage up to a wavelength, of bounded steepness."""
    longest = own[-1]
    exponent = _exponent(own[-FITTED_OCTAVES:])
    octaves = []
    wavelength_m = 2 * longest.wavelength_m
    while wavelength_m <= longest_m:
        grown_m = longest.deviation_m * (wavelength_m / longest.wavelength_m) ** exponent
        most_m = max(longest.deviation_m, MAX_STEEPNESS * wavelength_m)
        least_m = MIN_STEEPNESS * wavelength_m
        octaves.append(Octave(wavelength_m, min(max(grown_m, least_m), most_m)))
        wavelength_m *= 2
    return octaves


def _exponent(octaves: list[Octave]) -> float:
    """Return the fitted exponent by which amplitudes grow with the wavelength."""
    waves, deviations = np.log(np.maximum(np.array(octaves)[:, :2], 1e-9)).T
    offset = waves - waves.mean()
    fitted = offset @ deviations / max(offset @ offset, 1e-12)
    return float(np.clip(fitted, MIN_EXPONENT, MAX_EXPONENT))
