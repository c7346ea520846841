"""A ground under water and gravity through time, from coarse grids to fine ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from oaisys_core.procedural.terrain.noise import fractal, grid
from oaisys_core.procedural.terrain.processes.beds import Beds
from oaisys_core.procedural.terrain.processes.exact import tangent
from oaisys_core.procedural.terrain.processes.flow import Mask, route
from oaisys_core.procedural.terrain.processes.slopes import diffuse, slide, steepness
from oaisys_core.procedural.terrain.processes.stream_power import run_water
from oaisys_core.types import FloatArray

RESPONSE = 12.0
"""Erodibility times the time in which the rivers of a ground adjust to their base level, nearly
whatever its size: the integral of ds / sqrt(area) along a river, with Hack's law for the area."""

BEND_CELLS, BEND = 5.0, 2.2
"""Wavelength and amplitude, in cells of a coarse grid, by which valleys are bent on a finer one."""

WANDER = 0.7
"""Roughness of slopes, in what they fall from cell to cell: water wanders, and its ways do not
follow the grid."""

SLIDES = 2
"""Passes of slides in a step."""


@dataclass(frozen=True)
class Erosion:
    """How water and gravity shape a ground.

    Attributes:
        age: Duration, in the time in which rivers adjust to their base level: at 0.1 valleys have
            cut into the edges of a plateau, at 1 all is slopes.
        uplift_m: By how much rock would stand higher after the time of `age` 1 without erosion.
        deposition: Coefficient of deposition, see `run_water`.
        repose_deg: Steepest stable slope, where there are no beds.
        creep_m2: Diffusivity of soil times the time of `age` 1.
        beds: Layers of the rock; None for rock without.
    """

    age: float
    uplift_m: float = 0.0
    deposition: float = 0.7
    repose_deg: float = 36.0
    creep_m2: float = 0.0
    beds: Beds | None = None


@dataclass(frozen=True)
class Eroded:
    """A ground and what the processes left on it, all (rows, cols).

    Attributes:
        elevation_m: Heights.
        area_m2: Drained areas.
        deposited_m: Thickness of what water laid down in the last steps.
    """

    elevation_m: FloatArray
    area_m2: FloatArray
    deposited_m: FloatArray


def erode(
    elevation_m: FloatArray,
    spacing_m: float,
    erosion: Erosion,
    rng: np.random.Generator,
    *,
    steps: int,
    lift_m: float | FloatArray = 0.0,
    outlets: Mask | None = None,
) -> Eroded:
    """Return the ground after some time.

    Args:
        elevation_m: (rows, cols) heights.
        spacing_m: Distance between cells.
        erosion: The processes.
        rng: Draws where water runs.
        steps: Number of time steps; more are more exact.
        lift_m: By how much the beds lie higher, see `draw_lift`.
        outlets: Cells where water leaves; None for all edges.
    """
    z = elevation_m.astype(np.float64)
    duration = erosion.age / steps
    deposited_m = np.zeros_like(z)
    repose: float | FloatArray = tangent(erosion.repose_deg)
    erodibility: float | FloatArray = RESPONSE * duration
    area_m2 = np.zeros_like(z)
    roughness = WANDER * rng.uniform(-1.0, 1.0, z.shape)
    for step in range(steps):
        risen_m = erosion.uplift_m * duration * (step + 1)
        if erosion.beds is not None:
            hardness = erosion.beds.hardness_at(z, lift_m + risen_m)
            erodibility = RESPONSE * duration * erosion.beds.erodibility(hardness)
            repose = erosion.beds.repose(hardness)
        flow = route(_uneven(z, roughness), spacing_m, rng, outlets)
        work = run_water(
            z, flow, spacing_m, erodibility, erosion.uplift_m * duration, erosion.deposition
        )
        z = slide(work.elevation_m, spacing_m, repose, SLIDES)
        z = diffuse(z, spacing_m, erosion.creep_m2 * duration)
        deposited_m = 0.8 * deposited_m + work.deposited_m
        area_m2 = work.area_m2
    return Eroded(z, area_m2, deposited_m)


def _uneven(z: FloatArray, roughness: FloatArray) -> FloatArray:
    """Return heights on which water wanders as over stones, the more the steeper the slope."""
    return np.asarray(z + roughness * steepness(z, 1.0))


def grain(shape: tuple[int, ...], amplitude_m: float, rng: np.random.Generator) -> FloatArray:
    """Return (rows, cols) relief of a few cells, along which rills begin."""
    size_px = max(shape)
    x, y = grid(size_px / 4.0, size_px, 1.0)
    noise = fractal(x, y, rng, octaves=2)[: shape[0], : shape[1]]
    return np.asarray(amplitude_m * noise, np.float64)


def bend_shifts(
    size_px: int, cells: float, amplitude: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return two (size_px, size_px) shifts of rows and columns by noise with a given wavelength."""
    x, y = grid((size_px - 1) / cells, size_px, 1.0)
    first, second = (fractal(x, y, rng, octaves=2).astype(np.float64) for _ in range(2))
    return amplitude * first, amplitude * second


def upsample(elevation_m: FloatArray, size_px: int, rng: np.random.Generator) -> FloatArray:
    """Return (size_px, size_px) heights of a coarser square grid over the same ground.

    Places are shifted by noise, so that valleys, whose segments followed the coarse grid, bend.
    """
    factor = (len(elevation_m) - 1) / (size_px - 1)
    shifts = bend_shifts(size_px, BEND_CELLS / factor, BEND, rng)
    index = np.arange(size_px) * factor
    at = np.stack((index[:, None] + shifts[0], index[None, :] + shifts[1]))
    return np.asarray(scipy.ndimage.map_coordinates(elevation_m, at, order=3, mode="nearest"))
