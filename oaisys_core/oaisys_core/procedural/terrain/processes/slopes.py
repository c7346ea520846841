"""What gravity does to slopes: creep of soil, and slides down to the angle of repose."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.processes.flow import pair
from oaisys_core.types import FloatArray

STABLE = 0.2
"""Largest diffusivity times time over the squared spacing of an explicit step; 0.25 is unstable."""

DIAGONAL = 1.25
"""Mean distance, in cells, to the eight cells around, for octagons within 4 % of circles."""


def steepness(elevation_m: FloatArray, spacing_m: float) -> FloatArray:
    """Return the (rows, cols) tangents of the steepest slopes at the cells of a ground."""
    up = np.gradient(elevation_m, spacing_m)
    return np.asarray(np.sqrt(up[0] ** 2 + up[1] ** 2))


def diffuse(elevation_m: FloatArray, spacing_m: float, amount_m2: float) -> FloatArray:
    """Return the ground after linear hillslope diffusion (Culling 1960), which keeps its mass.

    No soil passes the edges.

    Args:
        elevation_m: (rows, cols) heights.
        spacing_m: Distance between cells.
        amount_m2: Diffusivity times time: a step becomes an error function of this width.
    """
    z = elevation_m.astype(np.float64)
    total = amount_m2 / spacing_m**2
    steps = max(int(np.ceil(total / STABLE)), 0)
    for _ in range(steps):
        change = np.zeros_like(z)
        for axis in (0, 1):
            flux = np.diff(z, axis=axis)
            flux *= total / steps
            low, high = pair(z.shape, 1 - axis, axis)
            change[low] += flux
            change[high] -= flux
        z += change
    return z


def slide(
    elevation_m: FloatArray,
    spacing_m: float,
    repose: float | FloatArray,
    steps: int,
    share: float = 0.8,
) -> FloatArray:
    """Return the ground after slopes above the angle of repose have slid; it keeps its mass.

    After Musgrave, Kolb and Mace, "The synthesis and rendering of eroded fractal terrains",
    SIGGRAPH 1989.

    Args:
        elevation_m: (rows, cols) heights.
        spacing_m: Distance between cells.
        repose: Tangents of the steepest stable slopes of what lies at each cell, a number or (rows,
            cols).
        steps: Number of passes.
        share: Of what is too much, how much slides in a pass.
    """
    z = elevation_m.astype(np.float64)
    steepest = np.asarray(repose, np.float64)
    varies = steepest.ndim > 0
    for _ in range(steps):
        change = np.zeros_like(z)
        slope = np.gradient(z, spacing_m)
        for axis in (0, 1):
            low, high = pair(z.shape, 1 - axis, axis)
            fall = np.diff(z, axis=axis)
            fall /= spacing_m
            steep = slope[1 - axis][low] + slope[1 - axis][high]
            steep *= 0.5
            steep *= steep
            steep += fall * fall
            np.sqrt(steep, out=steep)
            # What lies higher slides.
            stable = np.where(fall > 0, steepest[high], steepest[low]) if varies else steepest
            moved_m = steep - stable
            np.maximum(moved_m, 0.0, out=moved_m)
            moved_m /= np.maximum(steep, 1e-12, out=steep)
            moved_m *= fall
            moved_m *= share * spacing_m / 4
            change[low] += moved_m
            change[high] -= moved_m
        z += change
    return z


def wear_back(elevation_m: FloatArray, spacing_m: float, slope: float, reach: int) -> FloatArray:
    """Return the highest ground that is nowhere above this one, and nowhere steeper than a slope.

    It is what is left of a wall when what falls from it is carried away. Distances are those on
    octagons, within 4 % of circles.

    Args:
        elevation_m: (rows, cols) heights.
        spacing_m: Distance between cells.
        slope: Tangent of the steepest slope.
        reach: Cells from its foot up to which a wall wears back.
    """
    rises_m = slope * spacing_m, DIAGONAL * slope * spacing_m
    return bound_rises(elevation_m.astype(np.float64), rises_m, reach)


def bound_rises(height_m: FloatArray, rises_m: tuple[float, float], rounds: int) -> FloatArray:
    """Return the highest (rows, cols) heights that are nowhere above these and rise by no more.

    Args:
        height_m: (rows, cols) heights.
        rises_m: Largest rise from a cell to the next, straight, and among all eight around.
        rounds: Cells over which it is bounded.
    """
    import cv2

    # Turns of crosses and squares make octagons, nearly circles.
    shapes = [cv2.getStructuringElement(each, (3, 3)) for each in (cv2.MORPH_CROSS, cv2.MORPH_RECT)]
    for turn in range(rounds):
        least_m = cv2.erode(height_m, shapes[turn % 2], borderType=cv2.BORDER_REPLICATE)
        height_m = np.minimum(height_m, least_m + rises_m[turn % 2])
    return height_m
