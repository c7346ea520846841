"""Alpine ground: aretes, troughs that ice has left, moraines, and cones of debris below walls."""

from __future__ import annotations

import numpy as np

from oaisys_core import randomness
from oaisys_core.procedural.terrain.landform import (
    Elevation,
    GroundSpec,
    relief_or,
    subtract_median,
    unevenness,
)
from oaisys_core.procedural.terrain.landscapes.domain import COARSEST_PX, domain_of, stages_of
from oaisys_core.procedural.terrain.processes.bedrock import break_rock
from oaisys_core.procedural.terrain.processes.debris import drop_debris
from oaisys_core.procedural.terrain.processes.evolution import Erosion, erode, upsample
from oaisys_core.procedural.terrain.processes.exact import tangent
from oaisys_core.procedural.terrain.processes.flow import edge_cells, route
from oaisys_core.procedural.terrain.processes.ice import moraine, troughs_around
from oaisys_core.procedural.terrain.processes.mantle import lay_mantle
from oaisys_core.procedural.terrain.processes.slopes import steepness
from oaisys_core.types import FloatArray

PLAN = ((80, 1.2), (24, 0.17), (12, 0.045), (5, 0.01))
"""Steps and age on each grid, from the coarsest on."""

ICE_PX = 193
"""Grid on which ice flows: before the water of today, and its debris."""

SCREE_DEG = 35.0
ROCK_DEG = 52.0

JOINTS = (0.3, 0.29, 0.1, 0.09)
"""Spacing of joints in the height of the mountains: large ones part buttresses, small ones blocks,
and each size has joints of two directions."""

MANTLE, LEDGES, MANTLE_DEG = (0.018, 0.011), (0.005,), 41.0
"""Lengths in the height of the mountains by which debris is smooth, and soil on ledges; and the
angle of repose of both."""


def alpine(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """A high valley: rock walls with gullies, scree cones, a trough with moraines."""
    domain = domain_of(spec)
    height_m = relief_or(spec, 0.24 * spec.extent_m)
    tilt = domain.slope(rng)
    uplift_m = 0.75 * height_m
    start_m = height_m * (0.15 + 0.1 * tilt + 0.06 * domain.noise(5.0, rng, octaves=5))
    crags = 0.5 + 0.5 * domain.noise(14.0, rng, octaves=6, kind="ridged")
    z = np.zeros((0, 0))
    for size_px, steps, age in stages_of(domain, PLAN):
        outlets = edge_cells((size_px, size_px)) & (domain.at_size(tilt, size_px) < -0.25)
        spacing_m = domain.spacing_m(size_px)
        z = upsample(z, size_px, rng) if z.size else domain.at_size(start_m, size_px)
        z = np.where(outlets, 0.0, z)
        if size_px == ICE_PX:
            z = _glaciate(z, spacing_m, height_m, rng)
        elif size_px > ICE_PX:
            # Before the last water, which cuts gullies into it.
            z = lay_mantle(z, spacing_m, height_m, MANTLE, MANTLE_DEG)
        rises = 1.0 if size_px < ICE_PX else 0.0
        erosion = Erosion(
            age=age,
            uplift_m=rises * uplift_m,
            deposition=0.8,
            repose_deg=54.0,
            creep_m2=1e-6 * domain.extent_m**2,
        )
        z = erode(z, spacing_m, erosion, rng, steps=steps, outlets=outlets).elevation_m
        if size_px > COARSEST_PX:
            z = _shed(z, spacing_m, height_m, domain.at_size(crags, size_px), rng)
    rock_m = _break_walls(domain.cut(z, spec), spec, height_m, rng)
    covered_m = lay_mantle(rock_m, spec.spacing_m, height_m, LEDGES, MANTLE_DEG)
    return subtract_median(covered_m + spec.roughness * 0.3 * unevenness(spec, rng))


def _break_walls(
    z: FloatArray, spec: GroundSpec, height_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return the ground with buttresses, towers and ledges between joints where rock is bare."""
    for index, share in enumerate(JOINTS):
        drawn = randomness.child(rng, f"walls/{index}")
        z = break_rock(z, spec.spacing_m, share * height_m, drawn)
    return z


def _glaciate(
    z: FloatArray, spacing_m: float, height_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return the ground after glaciers have filled its main valleys and gone."""
    extent_m = spacing_m * (len(z) - 1)
    flow = route(z, spacing_m, rng)
    area_m2 = flow.on_grid(flow.accumulate(np.full(z.size, spacing_m**2)), z.shape)
    floor_m = np.where(area_m2 > 0.012 * extent_m**2, z, np.inf)
    half_m, depth_m = 0.075 * extent_m, 0.22 * height_m
    troughs = troughs_around(floor_m - 0.02 * height_m, spacing_m, half_m, depth_m)
    carved = np.minimum(z, troughs.surface_m)
    floors = troughs.floor_m[np.isfinite(troughs.floor_m)]
    if not len(floors):
        return carved
    head_m = float(floors.max())
    low_m = float(floors.min())
    for end in (0.1, 0.25):
        carved = carved + moraine(
            carved,
            troughs.floor_m,
            end_m=low_m + end * (head_m - low_m),
            head_m=head_m,
            thickness_m=0.16 * height_m,
            height_m=0.018 * height_m,
        )
    return carved


def _shed(
    z: FloatArray, spacing_m: float, height_m: float, crags: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Return the ground with rough rock walls, and the debris that fell from them."""
    steep = np.clip(steepness(z, spacing_m) - 0.6, 0.0, 0.6)
    z = z + 0.02 * height_m * steep * (crags - 0.8)
    shed_m, _ = drop_debris(
        z,
        spacing_m,
        rng,
        rock=tangent(ROCK_DEG) * (0.7 + 0.6 * crags),
        repose=tangent(SCREE_DEG),
        amount_m=0.03 * height_m,
        rounds=3,
    )
    return shed_m
