"""Tools for terrain presets: their parameters, fine unevenness, and scaling."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import fractal, grid, warp
from oaisys_core.types import FloatArray

LOG = logging.getLogger(__name__)

Elevation = NDArray[np.float32]


@dataclass(frozen=True)
class GroundSpec:
    """The parameters of a terrain preset.

    Attributes:
        extent_m: Edge length.
        resolution_px: Grid points along an edge.
        roughness: Factor on the fine unevenness.
        relief_m: Height of the large forms; None for the default of the preset.
    """

    extent_m: float
    resolution_px: int
    roughness: float = 1.0
    relief_m: float | None = None

    @property
    def spacing_m(self) -> float:
        """Distance between grid points."""
        return self.extent_m / (self.resolution_px - 1)


Preset = Callable[[GroundSpec, np.random.Generator], Elevation]
"""Returns (resolution_px, resolution_px) float32 elevations in metres."""


def unevenness(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Return fine relief with features from 2 m lumps down to 15 cm clods."""
    x, y = grid(spec.extent_m, spec.resolution_px, cell=2.6)
    patchy = 0.55 + 0.45 * fractal(x / 4, y / 4, rng, octaves=2)
    lumps = fractal(*warp(x, y, rng, 0.3, octaves=2), rng, octaves=2, kind="billow")
    clods = fractal(5 * x, 5 * y, rng, octaves=3, gain=0.6)
    rough = 0.60 * lumps + 0.11 * clods
    return np.asarray(rough * patchy, np.float32)


def scale_to_relief(field: Elevation | FloatArray, relief_m: float) -> Elevation:
    """Return the field scaled to 0 to ``relief_m``."""
    low, high = float(field.min()), float(field.max())
    return np.asarray((field - low) * np.float32(relief_m / max(high - low, 1e-9)), np.float32)


def subtract_median(elevation_m: Elevation | FloatArray) -> Elevation:
    """Return the field shifted so that its median is 0."""
    return np.asarray(elevation_m - np.median(elevation_m), np.float32)


def relief_or(spec: GroundSpec, default_m: float) -> float:
    """Return the requested relief, or the default of the preset."""
    return default_m if spec.relief_m is None else spec.relief_m


def warn_of_relief(relief_m: float, extent_m: float, deepest_m: float) -> None:
    """Say where a stage is too small for craters of the depth that is asked for."""
    if relief_m > deepest_m:
        LOG.warning(
            "stage.relief_m: received %g, but the largest crater on a stage of %g m is %.3g m deep",
            relief_m,
            extent_m,
            deepest_m,
        )


def refine(coarse: FloatArray, size_px: int) -> FloatArray:
    """Return a square field resampled to (size_px, size_px) by cubic splines."""
    if len(coarse) == size_px:
        return coarse
    factor = size_px / len(coarse)
    return np.asarray(scipy.ndimage.zoom(coarse, factor, order=3, mode="nearest", grid_mode=False))
