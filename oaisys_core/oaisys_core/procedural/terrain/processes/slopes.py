"""What gravity does to slopes: creep of soil, and slides down to the angle of repose."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.processes.flow import pair
from oaisys_core.types import FloatArray

STABLE = 0.2
"""Largest diffusivity times time over the squared spacing of an explicit step; 0.25 is unstable."""


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
    steepest = np.broadcast_to(np.asarray(repose, np.float64), z.shape)
    for _ in range(steps):
        change = np.zeros_like(z)
        slope = np.gradient(z, spacing_m)
        for axis in (0, 1):
            low, high = pair(z.shape, 1 - axis, axis)
            fall = np.diff(z, axis=axis) / spacing_m
            across = 0.5 * (slope[1 - axis][low] + slope[1 - axis][high])
            steep = np.sqrt(fall * fall + across * across)
            # What lies higher slides.
            stable = np.where(fall > 0, steepest[high], steepest[low])
            over = np.maximum(steep - stable, 0.0) / np.maximum(steep, 1e-12)
            moved_m = fall * over * (share * spacing_m / 4)
            change[low] += moved_m
            change[high] -= moved_m
        z += change
    return z
