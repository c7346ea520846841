"""Ground under impacts of all ages, as on the Moon."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.landform import (
    Elevation,
    GroundSpec,
    relief_or,
    subtract_median,
)
from oaisys_core.procedural.terrain.landscapes.domain import domain_of
from oaisys_core.procedural.terrain.noise import fractal, grid
from oaisys_core.procedural.terrain.processes.impacts import DEPTH, add_impacts, draw_impacts
from oaisys_core.procedural.terrain.processes.slopes import diffuse

COVERAGE = 0.07
SMALLEST_M = 0.25
LARGEST = 0.9
"""Diameter of a crater at most, in edges of the stage."""


def deepest_m(extent_m: float) -> float:
    """Return the depth of the largest crater that a stage has room for."""
    return DEPTH * LARGEST * extent_m


def crater_field(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Craters by a production function, each worn by diffusion since it formed.

    Relief is the depth of the largest crater that may fall.
    """
    largest_m = relief_or(spec, 0.07 * spec.extent_m) / DEPTH
    largest_m = min(largest_m, LARGEST * spec.extent_m)
    spacing_m = spec.spacing_m
    domain = domain_of(spec, margin=1.0)
    swells = 0.010 * spec.extent_m * domain.cut(domain.noise(3.0, rng, octaves=4), spec)
    smallest_m = max(SMALLEST_M, spec.extent_m / 400)
    z = swells
    if largest_m > smallest_m:
        impacts = draw_impacts(
            spec.extent_m,
            rng,
            smallest_m=smallest_m,
            largest_m=largest_m,
            equilibrium_m=0.4 * largest_m,
            coverage=COVERAGE,
        )
        z = add_impacts(swells, spacing_m, impacts, rng)
    # The last grains to fall have rounded what is as small as the grid.
    z = diffuse(z, spacing_m, 0.3 * spacing_m**2)
    x, y = grid(spec.extent_m / 0.5, spec.resolution_px, 1.0)
    grains = fractal(x, y, rng, octaves=3, gain=0.55)
    return subtract_median(z + 0.012 * spec.roughness * grains)
