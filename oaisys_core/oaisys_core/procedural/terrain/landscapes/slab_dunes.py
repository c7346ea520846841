"""Dunes that wind has built of slabs of sand, with ripples."""

from __future__ import annotations

import numpy as np
import scipy

from oaisys_core.procedural.terrain.landform import Elevation, GroundSpec, subtract_median
from oaisys_core.procedural.terrain.noise import fractal
from oaisys_core.procedural.terrain.processes.exact import draw_direction, tangent
from oaisys_core.procedural.terrain.processes.slopes import steepness
from oaisys_core.procedural.terrain.processes.wind import blow
from oaisys_core.types import FloatArray

SAND_PX = 224
"""Cells along an edge of the repeating field of sand."""

WIDER = 1.5
"""Edge of that field in edges of the stage, so that it covers it in any direction."""

NOISE_CELLS = 16
"""Cells of the noise by which the sand lies unevenly before the wind blows."""

STEPS, HOP = 600, 3
REPOSE_DEG = 33.0

SMOOTH = 1.1
"""Standard deviation, in cells, of the smoothing after which no slabs are seen."""

USUAL = 0.085
"""Thickness of the sand in edges of the stage."""

RIPPLE_M, RIPPLE_HEIGHT_M = 0.14, 0.012
"""Wavelength and height of ripples in sand (Sharp, J. Geol. 71, 1963)."""


def slab_dunes(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Dunes by the slab model; relief is about four times the mean thickness of the sand."""
    cell_m = WIDER * spec.extent_m / SAND_PX
    thickness_m = USUAL * spec.extent_m / 4 if spec.relief_m is None else spec.relief_m / 4
    cells = np.arange(SAND_PX) / (SAND_PX / NOISE_CELLS)
    x, y = np.meshgrid(cells, cells)
    noise = fractal(x, y, rng, octaves=2, period=NOISE_CELLS)
    sand = np.maximum(thickness_m / cell_m * (1.0 + 0.5 * noise), 0.0)
    sand = blow(sand, rng, steps=STEPS, hop=HOP, repose=tangent(REPOSE_DEG), turn_cells=0.0)
    sand = scipy.ndimage.gaussian_filter(sand, SMOOTH, mode="wrap")
    along, across = _turned(spec, rng)
    at = np.stack((across / cell_m, along / cell_m)) + SAND_PX / 2
    large_m = cell_m * scipy.ndimage.map_coordinates(sand, at, order=3, mode="grid-wrap")
    return subtract_median(large_m + spec.roughness * _ripples(spec, large_m, along, across, rng))


def _turned(spec: GroundSpec, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return the places of the ground along the wind and across it, from its centre."""
    east, north = draw_direction(rng)
    axis = np.linspace(-spec.extent_m / 2, spec.extent_m / 2, spec.resolution_px)
    x, y = axis[None, :], axis[:, None]
    return x * east + y * north, y * east - x * north


def _ripples(
    spec: GroundSpec,
    large_m: FloatArray,
    along: FloatArray,
    across: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return ripples across the wind, on sand that does not slide, if the ground can show them."""
    spacing_m = spec.spacing_m
    wave_m = max(RIPPLE_M, 4.5 * spacing_m)
    if wave_m > 4 * RIPPLE_M:
        return np.zeros_like(large_m)
    bends = 0.9 * fractal(along / 2.2, across / 3.5, rng, octaves=3)
    forks = 0.35 * fractal(along / 0.5, across / 1.1, rng, octaves=2)
    phase = along / wave_m + bends + forks
    share = phase - np.floor(phase)
    # A long rise and a short fall, of parabolas.
    wave = np.where(share < 0.65, share / 0.65, (1 - share) / 0.35)
    wave = wave * wave * (3 - 2 * wave)
    height = 0.75 + 0.5 * fractal(along / 4.0, across / 4.0, rng, octaves=2)
    shown = np.clip((0.52 - steepness(large_m, spacing_m)) / 0.1, 0.0, 1.0)
    return np.asarray(RIPPLE_HEIGHT_M * wave_m / RIPPLE_M * height * wave * shown)
