"""Canyons: a river has cut down into a plateau, and water its side canyons, through level beds."""

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
from oaisys_core.procedural.terrain.landscapes.domain import Domain, domain_of, stages_of
from oaisys_core.procedural.terrain.noise import fractal, grid
from oaisys_core.procedural.terrain.processes.bedrock import bend_to_joints, lay_talus
from oaisys_core.procedural.terrain.processes.evolution import Erosion, erode, grain, upsample
from oaisys_core.procedural.terrain.processes.exact import draw_direction
from oaisys_core.procedural.terrain.processes.mantle import lay_mantle
from oaisys_core.types import FloatArray

PLAN = ((40, 0.06), (20, 0.02), (10, 0.006), (6, 0.002))
"""Steps and age on each grid, from the coarsest on."""

WALL_DEG = 46.0
"""Mean slope of walls, over all beds."""

BENDS, HALF_WIDTH = 0.3, (0.07, 0.025)
"""Amplitude of the river's bends, and half of its floor's width with its variation, all in edges
of the domain."""

BEDS = ((4, 2.2, 0.4), (14, 1.7, 0.25))
"""Formations and the beds in them, from the floor to the rim: number of pairs of a soft one and a
hard one, and the horizontal runs of both, in that of the mean wall: benches and cliffs."""

CLIFF_CELLS = 1.0
"""Standard deviation, in cells, of the rounding of cliffs, which would follow the grid in steps."""

FOLDS = 0.012
"""By how much beds lie higher or lower, in the depth."""

JOINTS = 0.16, 0.07
"""Spacing of joints in the depth."""

TALUS = 0.12
"""Height of the walls at whose feet debris lies, in the depth."""

MANTLE, MANTLE_DEG = (0.02, 0.008), 38.0
"""Lengths in the depth by which soil and debris are smooth, and their repose."""


def canyon(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """A winding canyon in a plateau: cliffs and benches in layers, side canyons that branch."""
    depth_m = relief_or(spec, 0.22 * spec.extent_m)
    domain = domain_of(spec)
    valley_m = domain.cut(_cut_valleys(domain, depth_m, rng), spec)
    for index, share in enumerate(JOINTS):
        drawn = randomness.child(rng, f"walls/{index}")
        valley_m = bend_to_joints(valley_m, spec.spacing_m, share * depth_m, drawn)
    rock_m = valley_m
    for index, beds in enumerate(BEDS):
        drawn = randomness.child(rng, f"beds/{index}")
        rock_m = _step_out(rock_m, spec, depth_m, beds, drawn)
    # SciPy's filter has the same bits in all versions; OpenCV's has not.
    rock_m = scipy.ndimage.gaussian_filter(rock_m, CLIFF_CELLS, mode="nearest")
    covered_m = lay_talus(rock_m, spec.spacing_m, TALUS * depth_m, rng)
    covered_m = lay_mantle(covered_m, spec.spacing_m, depth_m, MANTLE, MANTLE_DEG)
    return subtract_median(covered_m + spec.roughness * 0.4 * unevenness(spec, rng))


def _cut_valleys(domain: Domain, depth_m: float, rng: np.random.Generator) -> FloatArray:
    """Return heights above the river after water has cut valleys into the plateau."""
    east, north = draw_direction(rng)
    axis = domain.axis(domain.finest_px)
    across = axis[:, None] * east - axis[None, :] * north
    across = across + BENDS * domain.noise(2.2, rng, octaves=2, gain=0.45, bend=0.2)
    half, varies = HALF_WIDTH
    beside_floor = np.abs(across) - half - varies * domain.noise(5.0, rng, octaves=2)
    plateau_m = depth_m * (1.0 + 0.03 * domain.noise(6.0, rng, octaves=5))
    z = np.zeros((0, 0))
    for size_px, steps, age in stages_of(domain, PLAN):
        outlets = domain.at_size(beside_floor, size_px) < 0
        z = upsample(z, size_px, rng) if z.size else domain.at_size(plateau_m, size_px)
        z = np.where(outlets, 0.0, z + grain(z.shape, 0.004 * depth_m, rng))
        erosion = Erosion(
            age=age, deposition=0.4, repose_deg=WALL_DEG, creep_m2=4e-7 * domain.extent_m**2
        )
        spacing_m = domain.spacing_m(size_px)
        z = erode(z, spacing_m, erosion, rng, steps=steps, outlets=outlets).elevation_m
    return z


def _step_out(
    valley_m: FloatArray,
    spec: GroundSpec,
    depth_m: float,
    beds: tuple[int, float, float],
    rng: np.random.Generator,
) -> FloatArray:
    """Return the ground with cliffs where beds are hard and benches where they are soft.

    Heights change, and places do not, so that all walls have the same beds, whatever their course.
    """
    pairs, *runs = beds
    thickness = rng.uniform(0.4, 1.6, 2 * pairs) * rng.uniform(0.5, 1.5, 2 * pairs)
    run = thickness * np.tile(runs, pairs)
    up = np.concatenate(([0.0], np.cumsum(thickness / thickness.sum())))
    at = np.concatenate(([0.0], np.cumsum(run / run.sum())))
    x, y = grid(spec.extent_m, spec.resolution_px, spec.extent_m / 12.0)
    fold = FOLDS * fractal(x, y, rng, octaves=4).astype(np.float64)
    share = valley_m / depth_m
    stepped = np.interp(share - fold, at, up) + fold
    # Above the rim and on the floor there are no beds.
    weight = np.clip(np.minimum(share, 1.0 - share) / (2 * FOLDS), 0.0, 1.0)
    return np.asarray(depth_m * (share + weight * (stepped - share)))
