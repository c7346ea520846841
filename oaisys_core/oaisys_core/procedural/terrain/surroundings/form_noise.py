"""Noise with the forms that water and impacts leave: ridges with gullies between them, and craters.

Like gradient noise, its values at a point depend on a few cells of a lattice alone, so that a
ground can have it at any resolution, and land as far as it reaches. Sums, products, quotients and
roots only: it has the same bits everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.terrain.processes.impacts import DEPTH, RIM
from oaisys_core.types import FloatArray

LATTICE = 64
"""Period of lattices in cells: octaves are left out before they repeat along a line of sight."""

JITTER = 0.35
"""Farthest shift of a point from its cell's middle, along an axis."""

REACH = 1.15
"""Distance in cells up to which a point counts: those of the cells around are always within it."""

WAVES = 0.75
"""Ridges in a cell."""

MEAN_FORM, FORM_DEVIATION = -0.18, 0.616
"""Mean and standard deviation of the profiles of ridges, as measured."""

CLEAR = 0.2
"""Share of the waves' weights that their sum must reach for forms of full height."""

RADII = (0.16, 0.46)
"""Radii of the craters of a lattice, in cells."""

EJECTA = 1.5
"""Extent of their ejecta in radii."""

BLOCK = 1 << 14
"""Points that are processed at once, so that they stay in the processor's cache."""

CRATER_DEVIATION = 0.0126
"""Standard deviation of the heights of a lattice of craters of true depth, in cells; measured."""


class Forms(NamedTuple):
    """Heights at N points.

    Attributes:
        height: (N,) with a standard deviation of about 1 on slopes in all directions.
        slope: (N, 2) their slopes along x and y, per cell.
    """

    height: FloatArray
    slope: FloatArray


def ridges(
    xy: FloatArray, downhill: FloatArray, rng: np.random.Generator, period: int = LATTICE
) -> Forms:
    """Return ridges and gullies that run down a slope: sharp crests above rounded beds.

    Each point of a lattice carries a wave across the slope, and they are summed by their distances
    (sparse convolution: Lagae et al., "Procedural noise using sparse Gabor convolution", ACM TOG
    28(3), 2009). Where slopes turn, ridges join. On the sum of a slope and its ridges, ridges of a
    finer lattice branch off, as gullies do.

    Args:
        xy: (N, 2) points in cells of the lattice.
        downhill: (N, 2) directions of the slope, of any length; its sign does not matter.
        rng: Draws the points.
        period: Size of the lattice in cells, after which it repeats.
    """
    points = _draw_points(rng, period)
    x, y = xy.T
    down_x, down_y = downhill.T
    steepness = np.maximum(np.sqrt(down_x * down_x + down_y * down_y), 1e-12)
    across_x, across_y = -down_y / steepness, down_x / steepness
    crest, side = np.empty((2, len(xy)), np.float32)
    for block in _blocks(len(xy)):
        across = across_x[block], across_y[block]
        crest[block], side[block] = _sum_waves(x[block], y[block], across, points)
    # With the phase p: 1 - 2 |sin(p / 2)|, a crest where p is 0.
    half_sine = np.sqrt(np.maximum(0.5 * (1.0 - crest), 0.0)).astype(np.float64)
    height = (1.0 - 2.0 * half_sine - MEAN_FORM) / FORM_DEVIATION
    # Of a cosine, which has no slope on crests either: gullies fade towards them.
    fall = side * (-2 * np.pi * WAVES / FORM_DEVIATION)
    return Forms(height, np.stack((fall * across_x, fall * across_y)).T)


def craters(xy: FloatArray, rng: np.random.Generator, period: int = LATTICE) -> FloatArray:
    """Return (N,) heights of craters of all ages, one in each cell, with a deviation of about 1.

    Args:
        xy: (N, 2) points in cells of the lattice.
        rng: Draws places, radii and ages.
        period: Size of the lattice in cells, after which it repeats.
    """
    points = _draw_points(rng, period)
    least, most = RADII
    sizes, ages = rng.random((2, period * period), np.float32)
    # Small craters are more frequent than large ones.
    radii = _with_margin((least + (most - least) * sizes * sizes * sizes).reshape(period, period))
    fresh = _with_margin((0.15 + 0.85 * ages * ages).reshape(period, period))
    x, y = xy.T
    total = np.zeros(len(xy))
    for block in _blocks(len(xy)):
        for offset_x, offset_y, cell in _neighbours(x[block], y[block], points):
            radius = radii.take(cell)
            r = np.sqrt(offset_x * offset_x + offset_y * offset_y) / radius
            bowl = 2 * (RIM - DEPTH * fresh.take(cell) * (1.0 - r * r))
            fading = np.clip((1.0 + EJECTA - r) / EJECTA, 0.0, 1.0)
            blanket = 2 * RIM * fading * fading * fading
            total[block] += radius * np.where(r < 1.0, np.minimum(bowl, blanket), blanket)
    return total / CRATER_DEVIATION


class _Lattice(NamedTuple):
    """Places of the points in their cells, with a margin of a cell.

    Attributes:
        period: Size of the lattice in cells.
        x, y: ((period + 2)^2,) the places, row by row.
    """

    period: int
    x: Field
    y: Field


def _draw_points(rng: np.random.Generator, period: int) -> _Lattice:
    drawn = rng.uniform(-1.0, 1.0, (period, period, 2))
    places = np.asarray(0.5 + JITTER * drawn, np.float32)
    return _Lattice(period, _with_margin(places[..., 0]), _with_margin(places[..., 1]))


def _with_margin(values: Field) -> Field:
    """Return the ((period + 2)^2,) values of the cells of a lattice and of a margin around them."""
    return np.pad(values, 1, mode="wrap").ravel()


def _blocks(count: int) -> Iterator[slice]:
    return (slice(first, first + BLOCK) for first in range(0, count, BLOCK))


def _neighbours(
    x: FloatArray, y: FloatArray, points: _Lattice
) -> Iterator[tuple[Field, Field, NDArray[np.intp]]]:
    """Yield offsets in x and y of places from the points of the nine cells around, and these cells.

    All are (N,), may be overwritten, and cells are those of the lattice with its margin.
    """
    low_x, low_y = np.floor(x), np.floor(y)
    x, y = (x - low_x).astype(np.float32), (y - low_y).astype(np.float32)
    wide = points.period + 2
    corner = low_y.astype(np.intp) % points.period * wide + low_x.astype(np.intp) % points.period
    for north in (-1, 0, 1):
        for east in (-1, 0, 1):
            cell = corner + ((north + 1) * wide + east + 1)
            from_x = x - np.float32(east)
            from_x -= points.x.take(cell)
            from_y = y - np.float32(north)
            from_y -= points.y.take(cell)
            yield from_x, from_y, cell


def _sum_waves(
    x: FloatArray, y: FloatArray, across: tuple[FloatArray, FloatArray], points: _Lattice
) -> tuple[Field, Field]:
    """Return the (N,) cosine and sine of the phase of the waves around each place.

    Both are smaller where waves cancel each other.
    """
    crest, side, weights = np.zeros((3, len(x)), np.float32)
    along_x, along_y = ((WAVES * each).astype(np.float32) for each in across)
    for offset_x, offset_y, _ in _neighbours(x, y, points):
        turns = offset_x * along_x
        turns += offset_y * along_y
        weight = np.square(offset_x, out=offset_x)
        weight += np.square(offset_y, out=offset_y)
        weight *= np.float32(-1 / REACH**2)
        weight += np.float32(1)
        np.maximum(weight, np.float32(0), out=weight)
        weight *= weight
        weights += weight
        cosine, sine = _wave(turns)
        cosine *= weight
        crest += cosine
        sine *= weight
        side += sine
    length = np.sqrt(crest * crest + side * side)
    length = np.maximum(length, np.float32(CLEAR) * weights + np.float32(1e-12))
    return crest / length, side / length


def _wave(turns: Field) -> tuple[Field, Field]:
    """Return about the cosine and the sine of angles in turns, from parabolas."""
    turns = turns - np.rint(turns)
    share = np.abs(turns)
    share *= np.float32(2)
    cosine = _fall(share)
    share -= np.float32(0.5)
    np.abs(share, out=share)
    return cosine, np.copysign(_fall(share), turns)


def _fall(share: Field) -> Field:
    """Return a smooth fall from 1 over 0 at a half to -1, over shares from 0 to 1."""
    fall = np.float32(4) * share
    fall -= np.float32(6)
    fall *= share
    fall *= share
    fall += np.float32(1)
    return fall
