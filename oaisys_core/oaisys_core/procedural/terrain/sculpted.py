"""Landforms shaped by wind, water and impacts: dunes, mesas, cratered plains."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.terrain.craters import DEPTH_SHARE, crater_field
from oaisys_core.procedural.terrain.erosion import REPOSE_DEG, slides
from oaisys_core.procedural.terrain.landform import (
    Elevation,
    GroundSpec,
    refine,
    relief_or,
    subtract_median,
    unevenness,
    warn_of_relief,
)
from oaisys_core.procedural.terrain.noise import fractal, grid, warp
from oaisys_core.procedural.terrain.processes.bedrock import bend_to_joints, lay_talus
from oaisys_core.types import FloatArray

SAND_PX = 385
"""Grid size for sliding sand, at any resolution of the ground."""

LEE_SHARE = 0.22
"""Length of the slip face relative to the length of a dune along the wind."""

RIPPLE_M = 0.32
RIPPLE_HEIGHT_M = 0.012
"""Wind ripples, used if the grid has at least four points per ripple."""


CLIFF_CELLS = 1.0
"""Standard deviation in cells of the smoothing of cliffs, which stay as steep as 83 degrees."""


JOINTS = 0.3
"""Spacing of the joints that the walls of a mesa follow, in its height."""

LARGEST_CRATER, MIN_LARGEST_CRATER, MAX_LARGEST_CRATER = 0.33, 1 / 400, 0.9
"""Diameter of the largest crater in edges of the stage: usually, below which there are none, and at
most."""


def dunes(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Sand dunes across the wind: long windward slopes, slip faces at the angle of repose."""
    length_m = spec.extent_m / 4.5
    height_m = relief_or(spec, 0.1 * length_m)
    p, q = _rotate_grid(spec.extent_m, SAND_PX, rng)
    u, v = p / length_m, q / length_m
    bend = 0.75 * fractal(u / 2.2, v / 2.2, rng, octaves=2) + 0.12 * fractal(u, v, rng, octaves=2)
    # Crests wind to and fro within a few of their heights.
    bend += 0.09 * fractal(2.5 * u, 2.5 * v, randomness.child(rng, "winding"), octaves=2)
    size = np.clip(0.75 + 0.55 * fractal(u / 1.7, v / 1.7, rng, octaves=2), 0.15, 1.2)
    second = _dune(2.7 * u + 0.8 * fractal(u, v, rng, octaves=2))
    sand_m = height_m * (size * _dune(u + bend) + 0.16 * second)
    spacing_m = spec.extent_m / (SAND_PX - 1)
    sand_m = slides(sand_m, spacing_m, steps=40, repose_deg=REPOSE_DEG)
    fine_m = refine(sand_m, spec.resolution_px) + spec.roughness * _ripples(spec, rng)
    return subtract_median(fine_m)


def _dune(phase: FloatArray) -> FloatArray:
    """Return the profile of a dune, 0 to 1, with period 1: a slow rise and a steep fall."""
    t = phase - np.floor(phase)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.clip(t / (1 - LEE_SHARE), 0, 1))
    fall = 0.5 + 0.5 * np.cos(np.pi * np.clip((t - 1 + LEE_SHARE) / LEE_SHARE, 0, 1))
    return np.asarray(np.where(t < 1 - LEE_SHARE, rise**1.15, fall))


def _ripples(spec: GroundSpec, rng: np.random.Generator) -> FloatArray:
    spacing_m = spec.spacing_m
    if 4 * spacing_m > RIPPLE_M:
        return np.zeros((spec.resolution_px, spec.resolution_px))
    p, q = _rotate_grid(spec.extent_m, spec.resolution_px, rng)
    phase = p / RIPPLE_M + 2.2 * fractal(p / 3.0, q / 3.0, rng, octaves=2)
    height = 0.6 + 0.4 * fractal(p / 5.0, q / 5.0, rng, octaves=1)
    return np.asarray(RIPPLE_HEIGHT_M * height * np.cos(2 * np.pi * phase))


def mesa(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Table mountains: level tops, fluted cliffs in layers, aprons of scree, a plain around."""
    height_m = relief_or(spec, 0.14 * spec.extent_m)
    x, y = grid(spec.extent_m, spec.resolution_px, cell=spec.extent_m / 2.4)
    wx, wy = warp(x, y, rng, strength=0.3, octaves=2)
    shape = fractal(wx, wy, rng, octaves=4, gain=0.42)
    flutes = fractal(9 * x, 9 * y, rng, octaves=2, kind="billow")
    spacing_m = spec.spacing_m
    inside = bend_to_joints(_equalise(shape), spacing_m, JOINTS * height_m, rng)
    inside = inside + 0.035 * (flutes - 0.3)
    # The profile: cumulative shares of the ground, and heights.
    at = (0.0, 0.52, 0.60, 0.612, 0.650, 0.660, 0.700, 0.708, 1.0)
    up = (0.0, 0.030, 0.20, 0.46, 0.56, 0.76, 0.82, 0.975, 1.0)
    outline = np.interp(inside, at, up)
    rolling = 0.02 * fractal(2 * x, 2 * y, rng, octaves=3)
    large_m = (np.float32(height_m) * _round(outline + rolling)).astype(np.float64)
    large_m = lay_talus(large_m, spacing_m, 0.65 * height_m, rng)
    return subtract_median(large_m + spec.roughness * 0.6 * unevenness(spec, rng))


def _round(outline: FloatArray) -> NDArray[np.float32]:
    """Return an outline whose cliffs are a few cells wide.

    Within a single cell, a cliff follows the grid in steps: its triangles face to and fro, and in
    sunlight along the wall every other one is black.
    """
    # SciPy's filter has the same bits in all versions; OpenCV's has not.
    rounded = scipy.ndimage.gaussian_filter(outline.astype(np.float64), CLIFF_CELLS, mode="mirror")
    return np.asarray(rounded, np.float32)


def craters(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """A plain under impact craters of all sizes and ages, as on the Moon.

    Relief is the depth of the largest crater, which is fresh, and whose diameter follows: at any
    relief, craters are as deep for their size.
    """
    largest_m = LARGEST_CRATER * spec.extent_m
    swell_m = 0.012 * spec.extent_m
    if spec.relief_m is not None:
        usual_m, largest_m = largest_m, _diameter_m(spec.relief_m, spec.extent_m)
        swell_m *= min(largest_m / usual_m, 1.0)
    smallest_m = max(0.4, spec.extent_m / 400)
    x, y = grid(spec.extent_m, spec.resolution_px, cell=spec.extent_m / 3.0)
    large_m = swell_m * fractal(x, y, rng, octaves=4, gain=0.5)
    if largest_m > MIN_LARGEST_CRATER * spec.extent_m:
        large_m = large_m + crater_field(
            spec.resolution_px,
            spec.extent_m,
            rng,
            largest_m=largest_m,
            smallest_m=min(smallest_m, largest_m / 2),
            has_largest=spec.relief_m is not None,
        )
    return subtract_median(large_m + spec.roughness * 0.18 * unevenness(spec, rng))


def _diameter_m(depth_m: float, extent_m: float) -> float:
    """Return the diameter of a fresh crater of a depth, as large as a stage can have it."""
    most_m = MAX_LARGEST_CRATER * extent_m
    warn_of_relief(depth_m, extent_m, DEPTH_SHARE * most_m)
    return min(depth_m / DEPTH_SHARE, most_m)


def _rotate_grid(
    extent_m: float, size_px: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return (size_px, size_px) coordinates in metres from the centre, randomly rotated."""
    heading = rng.uniform(0, 2 * np.pi)
    axis = np.linspace(-extent_m / 2, extent_m / 2, size_px)
    x, y = np.meshgrid(axis, axis)
    along = x * np.cos(heading) + y * np.sin(heading)
    return along, y * np.cos(heading) - x * np.sin(heading)


def _equalise(field: Elevation) -> FloatArray:
    """Return the share of the field, 0 to 1, that is lower than each point."""
    values = np.sort(field[:: max(len(field) // 256, 1), :: max(len(field) // 256, 1)], axis=None)
    levels = np.linspace(0, len(values) - 1, 512).astype(np.intp)
    return np.interp(field, values[levels], levels / (len(values) - 1))
