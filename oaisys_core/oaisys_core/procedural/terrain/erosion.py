"""Erosion of height fields: by running water and by sliding slopes.

All functions work on float64 grids of elevations with a spacing of ``spacing_m``.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.types import FloatArray

NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""(row, column) offsets of the eight neighbours of a cell."""

REPOSE_DEG = 34.0
"""Angle of repose of dry sand and scree."""


def streams(
    elevation_m: FloatArray | Field,
    spacing_m: float,
    rng: np.random.Generator,
    *,
    steps: int,
    strength: float = 0.02,
    area_exponent: float = 0.4,
    creep: float = 0.05,
    repose_deg: float = 40.0,
) -> FloatArray:
    """Return the field after running water has cut valleys (detachment-limited stream power).

    Each step lowers a cell by ``strength * area**area_exponent * slope`` towards the lowest of its
    neighbours, where ``area`` is the number of cells that drain through it. Then slopes above
    ``repose_deg`` slide, and soil creeps. Howard, "A detachment-limited model of drainage basin
    evolution", WRR 30(7), 1994.

    Args:
        elevation_m: The field before erosion.
        spacing_m: Distance between grid points.
        rng: Perturbs the flow directions, so that valleys do not follow the grid.
        steps: Number of steps.
        strength, area_exponent: Parameters of the erosion by water.
        creep: Share by which a cell moves towards the mean of its neighbours in each step.
        repose_deg: Steepest stable slope.
    """
    z = elevation_m.astype(np.float64)
    for _ in range(steps):
        receiver, slope = _steepest(z, spacing_m, rng)
        area = drainage_area(receiver)
        power = strength * area.reshape(z.shape) ** area_exponent * slope * spacing_m
        drop_m = z - z.ravel()[receiver].reshape(z.shape)
        z -= np.minimum(power, 0.5 * np.maximum(drop_m, 0.0))
        z = _with_filled_pits(z)
        z += creep * (scipy.ndimage.uniform_filter(z, 3, mode="nearest") - z)
        z = slides(z, spacing_m, steps=1, repose_deg=repose_deg)
    return z


def drainage_area(receiver: NDArray[np.int64]) -> FloatArray:
    """Return the number of cells, including itself, that drain through each of (N,) cells.

    Args:
        receiver: (N,) index of the cell that each one drains into; its own index at a pit.
    """
    count = len(receiver)
    # Pits drain into an extra cell, so that there are no cycles.
    jump = np.where(receiver == np.arange(count), count, receiver)
    jump = np.append(jump, count)
    area = np.ones(count + 1)
    area[count] = 0.0
    # After k rounds a cell has counted all cells within 2**k steps upstream.
    while (jump[:count] != count).any():
        area[:count] += np.bincount(jump, weights=area, minlength=count + 1)[:count]
        area[count] = 0.0
        jump = jump[jump]
    return area[:count]


def slides(
    elevation_m: FloatArray,
    spacing_m: float,
    *,
    steps: int,
    repose_deg: float = REPOSE_DEG,
    share: float = 0.8,
) -> FloatArray:
    """Return the field after slopes above the angle of repose have slid down (thermal erosion).

    After Musgrave, Kolb and Mace, "The synthesis and rendering of eroded fractal terrains",
    SIGGRAPH 1989. The total mass does not change.
    """
    z = elevation_m.astype(np.float64)
    steepest = np.tan(np.radians(repose_deg)) * spacing_m
    for _ in range(steps):
        change = np.zeros_like(z)
        for row, col in ((0, 1), (1, 0), (1, 1), (1, -1)):
            here, there = _pair(z.shape, row, col)
            fall = z[here] - z[there]
            least = steepest * float(np.hypot(row, col))
            # The material is shared between the neighbours.
            moved = np.clip(fall, -least, least)
            moved = (fall - moved) * (share / 4)
            change[here] -= moved
            change[there] += moved
        z += change
    return z


def receivers(
    elevation_m: FloatArray, spacing_m: float, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Return the (N,) receivers of all cells, see `drainage_area`; ``rng`` perturbs them."""
    return _steepest(elevation_m, spacing_m, rng)[0]


def _steepest(
    z: FloatArray, spacing_m: float, rng: np.random.Generator
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the (N,) receivers of all cells (see `drainage_area`), and the slopes towards them."""
    index = np.arange(z.size).reshape(z.shape)
    receiver, best, slope = index.copy(), np.zeros_like(z), np.zeros_like(z)
    for row, col in NEIGHBOURS:
        here, there = _pair(z.shape, row, col)
        fall = (z[here] - z[there]) / (spacing_m * float(np.hypot(row, col)))
        drawn = fall * rng.uniform(0.6, 1.4, fall.shape)
        steeper = drawn > best[here]
        best[here][steeper] = drawn[steeper]
        slope[here][steeper] = fall[steeper]
        receiver[here][steeper] = index[there][steeper]
    return receiver.ravel(), slope


def _with_filled_pits(z: FloatArray) -> FloatArray:
    """Return the field with each pit raised to its lowest neighbour."""
    lowest = np.full_like(z, np.inf)
    for row, col in NEIGHBOURS:
        here, there = _pair(z.shape, row, col)
        np.minimum(lowest[here], z[there], out=lowest[here])
    inner = np.zeros(z.shape, bool)
    inner[1:-1, 1:-1] = True
    return np.where(inner, np.maximum(z, lowest), z)


def _pair(
    shape: tuple[int, ...], row: int, col: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return slices of the cells that have a neighbour at an offset, and of these neighbours."""
    rows, cols = shape
    here = (
        slice(max(-row, 0), rows - max(row, 0)),
        slice(max(-col, 0), cols - max(col, 0)),
    )
    there = (
        slice(max(row, 0), rows - max(-row, 0)),
        slice(max(col, 0), cols - max(-col, 0)),
    )
    return here, there
