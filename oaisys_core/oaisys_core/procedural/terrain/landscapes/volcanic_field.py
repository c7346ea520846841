"""A volcanic field: flows of lava with ridged and broken crusts, around cones of cinder."""

from __future__ import annotations

import numpy as np
import scipy

from oaisys_core import randomness
from oaisys_core.procedural.terrain.landform import (
    Elevation,
    GroundSpec,
    relief_or,
    subtract_median,
    unevenness,
)
from oaisys_core.procedural.terrain.landscapes.domain import Domain, domain_of
from oaisys_core.procedural.terrain.noise import fractal, grid
from oaisys_core.procedural.terrain.processes.evolution import Erosion, erode
from oaisys_core.procedural.terrain.processes.exact import draw_direction, tangent
from oaisys_core.procedural.terrain.processes.flow import Mask, edge_cells
from oaisys_core.procedural.terrain.processes.lava import LavaFlow, cinder_cone, emplace
from oaisys_core.types import FloatArray

FLOWS, LOBES = 4, 420
CONES = (1, 3)
"""Least and most cones."""

RIM_LOW, RIM_LUMPS = 0.3, 0.07
"""How much a rim is lower to windward, and how high its lumps are, in the cone's height."""

CINDER_DEG = 32.0


def volcanic_field(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Cinder cones on a plain, and lava flows of several ages with lobes, ridges and cracks."""
    domain = domain_of(spec)
    height_m = relief_or(spec, 0.1 * spec.extent_m)
    tilt = domain.slope(rng)
    z = 0.03 * domain.extent_m * tilt + 0.05 * height_m * domain.noise(4.0, rng, octaves=4)
    spacing_m = domain.spacing_m(domain.finest_px)
    z, vents = _add_cones(z, domain, height_m, rng)
    gullies = Erosion(age=0.015, deposition=0.5, repose_deg=CINDER_DEG + 2)
    # Water seeps away in craters, and does not cut through their rims.
    outlets = vents | edge_cells(z.shape)
    z = erode(z, spacing_m, gullies, rng, steps=4, outlets=outlets).elevation_m
    for index in range(FLOWS):
        z = _add_flow(z, domain, height_m, 1.0 - 0.25 * index, rng)
    return subtract_median(domain.cut(z, spec) + spec.roughness * 0.15 * unevenness(spec, rng))


def _add_cones(
    z: FloatArray, domain: Domain, height_m: float, rng: np.random.Generator
) -> tuple[FloatArray, Mask]:
    """Return the ground with cones, and (rows, cols) whether a cell is in one of their vents."""
    vents = np.zeros(z.shape, bool)
    axis = domain.axis(domain.finest_px) * domain.extent_m
    bends = 0.05 * domain.extent_m * domain.noise(6.0, rng, octaves=3)
    lumps = domain.noise(24.0, randomness.child(rng, "rims"), octaves=3)
    wind = draw_direction(randomness.child(rng, "wind"))
    for index in range(int(rng.integers(*CONES, endpoint=True))):
        share = 1.0 if index == 0 else float(rng.uniform(0.3, 0.6))
        x_m, y_m = rng.uniform(-0.36, 0.36, 2) * domain.extent_m
        east_m = axis[None, :] - x_m + 0.35 * share * bends
        north_m = axis[:, None] - y_m - 0.35 * share * bends.T
        cone = cinder_cone(
            east_m, north_m, height_m=share * height_m, repose=tangent(CINDER_DEG), crater=0.35
        )
        z = z + cone - _low_rim(cone, east_m, north_m, share * height_m, lumps, wind)
        near_m = 0.15 * share * height_m
        vents |= (axis[None, :] - x_m) ** 2 + (axis[:, None] - y_m) ** 2 < near_m**2
    return z, vents


def _low_rim(
    cone_m: FloatArray,
    east_m: FloatArray,
    north_m: FloatArray,
    height_m: float,
    lumps: FloatArray,
    wind: tuple[float, float],
) -> FloatArray:
    """Return by how much a cone is lower than an even one: most at its rim, on the windward side.

    Wind carries cinder to one side, and what falls back slides (Porter, GSA Bull. 83, 1972).
    """
    away_m = np.sqrt(east_m * east_m + north_m * north_m) + 0.01 * height_m
    windward = 0.5 - 0.5 * (wind[0] * east_m + wind[1] * north_m) / away_m
    near_rim = (cone_m / height_m) ** 2
    return np.asarray(height_m * near_rim * (RIM_LOW * windward + RIM_LUMPS * lumps))


def _add_flow(
    z: FloatArray, domain: Domain, height_m: float, age: float, rng: np.random.Generator
) -> FloatArray:
    """Return the ground with one more flow; older ones are smoother and covered by fines."""
    spacing_m = domain.spacing_m(domain.finest_px)
    x_m, y_m = rng.uniform(0.15, 0.85, 2) * domain.extent_m
    thickness_m = 0.02 * height_m * float(rng.uniform(0.7, 1.3))
    flow = LavaFlow((x_m, y_m), LOBES, 0.028 * domain.extent_m, 0.5 * thickness_m)
    after = emplace(z, spacing_m, flow, rng)
    # Lava is level where it has piled up, but for its edges.
    lava_m = 4.5 * thickness_m * (1.0 - 1.0 / (1.0 + after.lava_m / (1.5 * thickness_m)))
    lava_m = scipy.ndimage.gaussian_filter(lava_m, 1.0)
    covered = np.clip(lava_m / thickness_m - 0.2, 0.0, 1.0)
    ridges = _crust(domain, after.reached, thickness_m, rng)
    return np.asarray(z + lava_m + (1.0 - 0.6 * age) * covered * ridges)


def _crust(
    domain: Domain, reached: FloatArray, thickness_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return the relief of a flow's crust: pressure ridges across its way, slabs, and rubble.

    Ridges are bowed downstream; they follow lines that the lava reached at the same time.
    """
    lines = scipy.ndimage.gaussian_filter(reached, 0.012 * domain.finest_px)
    wave = lines * 0.9 + 0.5 * domain.noise(26.0, rng, octaves=3)
    phase = wave - np.floor(wave)
    fold = 1.0 - np.abs(2.0 * phase - 1.0)
    fold = fold * fold
    patches = np.clip(0.5 + domain.noise(8.0, rng, octaves=3), 0.0, 1.0)
    x, y = grid(domain.extent_m / (2.2 * thickness_m), domain.finest_px, 1.0)
    slabs = fractal(x, y, rng, octaves=5, gain=0.6, kind="billow").astype(np.float64)
    cracks = fractal(0.8 * x, 0.8 * y, rng, octaves=2, kind="ridged").astype(np.float64)
    cracks = np.clip(cracks - 0.86, 0.0, 0.14) / 0.14
    return np.asarray(
        thickness_m * (0.9 * patches * fold + 1.1 * (slabs - 0.3) - 0.7 * cracks * patches)
    )
