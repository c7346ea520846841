"""Badlands: soft layered rock, cut by rills into knife edges, with fans at their feet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oaisys_core.procedural.terrain.landform import (
    Elevation,
    GroundSpec,
    relief_or,
    subtract_median,
    unevenness,
)
from oaisys_core.procedural.terrain.landscapes.domain import Domain, domain_of, stages_of
from oaisys_core.procedural.terrain.processes.beds import draw_beds, draw_lift
from oaisys_core.procedural.terrain.processes.evolution import Erosion, erode, grain, upsample
from oaisys_core.procedural.terrain.processes.flow import edge_cells
from oaisys_core.types import FloatArray

PLAN = ((60, 0.35), (30, 0.1), (16, 0.05), (8, 0.02))
"""Steps and age on each grid, from the coarsest on."""


def badlands(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """A plateau of soft beds and hard ones that rills have cut into edges, spurs and washes."""
    domain = domain_of(spec)
    height_m = relief_or(spec, 0.16 * spec.extent_m)
    tilt = domain.slope(rng)
    plateau_m = height_m * (0.62 + 0.5 * domain.noise(5.0, rng, octaves=5) + 0.12 * tilt)
    beds = draw_beds(
        rng, -0.1 * height_m, 1.2 * height_m, count=6, contrast=4.0, repose_deg=(33.0, 60.0)
    )
    lift_m = draw_lift(domain.finest_px, domain.extent_m, rng, 0.03, 0.03 * height_m)
    erosion = Erosion(age=0.0, deposition=0.7, creep_m2=1e-6 * domain.extent_m**2, beds=beds)
    z = np.zeros((0, 0))
    for size_px, steps, age in stages_of(domain, PLAN):
        outlets = edge_cells((size_px, size_px)) & (domain.at_size(tilt, size_px) < -0.35)
        z = _begin(domain, plateau_m, size_px) if not z.size else upsample(z, size_px, rng)
        z = np.where(outlets, 0.0, z + grain(z.shape, 0.004 * height_m, rng))
        result = erode(
            z,
            domain.spacing_m(size_px),
            replace(erosion, age=age),
            rng,
            steps=steps,
            lift_m=domain.at_size(lift_m, size_px),
            outlets=outlets,
        )
        z = result.elevation_m
    return subtract_median(domain.cut(z, spec) + spec.roughness * 0.12 * unevenness(spec, rng))


def _begin(domain: Domain, plateau_m: FloatArray, size_px: int) -> FloatArray:
    return domain.at_size(plateau_m, size_px).copy()
