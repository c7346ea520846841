"""Noise that clouds are made of; it repeats after its period without a seam.

Lobes are inverted distances to the nearest of random points (Worley, "A cellular texture basis
function", SIGGRAPH 1996), summed over octaves with the weights of Schneider, "The real-time
volumetric cloudscapes of Horizon Zero Dawn" (SIGGRAPH 2015, Advances in Real-Time Rendering).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np

from oaisys_core import randomness
from oaisys_core.procedural.terrain.noise import Field

LEVELS, PERIOD = 64, 128
"""Voxels of the noise upwards, and along each side."""

CELLS, WEIGHTS = (8, 16, 32), (0.625, 0.25, 0.125)
"""Lobes along a side, by octave, and the weights of the octaves."""

SEED = 20151
"""The lobes are the same in every world, because worlds differ by which of them clouds show."""


@lru_cache(maxsize=1)
def billows() -> Field:
    """Return (LEVELS, PERIOD, PERIOD) lobes with a mean of 0 and a standard deviation of 1."""
    total = np.zeros((LEVELS, PERIOD, PERIOD), np.float32)
    for cells, weight in zip(CELLS, WEIGHTS, strict=True):
        rng = randomness.stream(SEED, "billows", cells)
        total -= np.float32(weight) * nearest(cells * LEVELS // PERIOD, cells, PERIOD, rng)
    return standardise(total)


def lobes_in_plane(cells: int, period: int, rng: np.random.Generator) -> Field:
    """Return (period, period) lobes of one octave, with a mean of 0 and a deviation of 1."""
    return standardise(-nearest(0, cells, period, rng)[0])


def standardise(field: Field) -> Field:
    """Return a field with a mean of 0 and a standard deviation of 1."""
    mean, deviation = field.mean(dtype=np.float64), field.std(dtype=np.float64)
    return (field - np.float32(mean)) * np.float32(1 / deviation)


def nearest(levels: int, cells: int, period: int, rng: np.random.Generator) -> Field:
    """Return (Z, period, period) distances to the nearest of random points, one a cell, in cells.

    Args:
        levels: Cells upwards; 0 for points and voxels in one plane, with a Z of 1.
        cells: Cells along the sides; the period is a multiple of them.
        period: Voxels along the sides.
        rng: Draws the points.
    """
    step = period // cells
    counts, steps = (max(levels, 1), cells, cells), (step if levels else 1, step, step)
    points = rng.random((3, *counts), dtype=np.float32)
    if not levels:
        points[0] = 0.5
    # A cell's index comes before that of the voxel in it.
    shape = [size for pair in zip(counts, steps, strict=True) for size in pair]
    found = np.full(shape, 9.0, np.float32)
    around = (-1, 0, 1)
    for shift in product(around if levels else (0,), around, around):
        square = np.zeros((1,) * 6, np.float32)
        for axis, size in enumerate(steps):
            there = np.roll(points[axis], [-each for each in shift], axis=(0, 1, 2)) + shift[axis]
            own = [1] * 6
            own[2 * axis + 1] = size
            inside = (np.arange(size, dtype=np.float32) + np.float32(0.5)) / size
            square = square + (inside.reshape(own) - there[:, None, :, None, :, None]) ** 2
        np.minimum(found, square, out=found)
    return np.sqrt(found).reshape([n * each for n, each in zip(counts, steps, strict=True)])
