"""Erosion of any ground that is a grid: of presets, and of elevation models below their posting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from oaisys_core.config.sections.erosion import ErosionConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.landscapes.kept import make_once
from oaisys_core.procedural.terrain.processes.beds import Beds, draw_beds, draw_lift
from oaisys_core.procedural.terrain.processes.evolution import (
    BEND,
    BEND_CELLS,
    Erosion,
    bend_shifts,
    erode,
    grain,
)
from oaisys_core.procedural.terrain.processes.exact import tangent
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray

COARSEST_PX, FINEST_PX = 129, 1025
"""Edges of the grids at which water begins to run, and beyond which only gravity works."""

STEPS = (8, 14, 24, 40)
"""Steps on each grid, from the finest on; coarser ones have as many as the last."""

AGES = (0.06, 0.14, 0.3, 0.5)
"""Shares of the age on each grid, from the finest on."""

GRAIN = 0.05
"""Height, in spacings, of the relief of a few cells along which rills begin."""

MEAN_ROUNDS = 3
"""Rounds by which the means over the pixels of an elevation model come back."""


def erode_ground(
    ground: HeightField,
    config: ErosionConfig,
    rng: np.random.Generator,
    posting_m: float | None = None,
    field: str = "stage.erosion",
) -> HeightField:
    """Return a ground after water and gravity have shaped it.

    Args:
        ground: The ground before.
        config: The processes.
        rng: Draws where water runs, and the beds.
        posting_m: Distance between the heights of an elevation model, whose means over squares of
            this edge stay; None to shape all forms.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: The ground's grid is not finer than the posting.
    """
    if posting_m is not None and posting_m < 1.5 * ground.spacing_m:
        expected = (
            f"a stage.dem.ground_spacing_m of at most two thirds of the model's {posting_m:.6g} m"
            " (or below_posting: false, which shapes all forms)"
        )
        raise InvalidInputError(f"{field}.below_posting", ground.spacing_m, expected)
    before_m = ground.elevation_m.astype(np.float64)
    key = (before_m.shape, ground.elevation_m.tobytes(), ground.spacing_m, repr(config), posting_m)

    def make() -> FloatArray:
        after_m = _erode_all(before_m, ground.spacing_m, config, rng)
        if posting_m is None:
            return after_m
        return _with_means_of(before_m, after_m, posting_m / ground.spacing_m)

    return replace(ground, elevation_m=make_once("eroded", key, rng, make))


def _erode_all(
    z: FloatArray, spacing_m: float, config: ErosionConfig, rng: np.random.Generator
) -> FloatArray:
    """Return the heights after erosion on all grids, from a coarse one to the ground's."""
    erosion = Erosion(
        age=0.0,
        deposition=config.deposition,
        repose_deg=config.repose_deg,
        creep_m2=0.5 * config.creep_m**2 / config.age,
        beds=_beds(z, config, rng),
    )
    longest = max(z.shape)
    lift_m = _lift(longest, longest * spacing_m, config, rng)[: z.shape[0], : z.shape[1]]
    # No coarse grid has less than two rows or columns.
    most = int(np.log2(max((min(z.shape) - 1) / 2, 1.0)))
    halvings = range(min(int(np.ceil(np.log2(max(longest / COARSEST_PX, 1.0)))), most) + 1)
    change_m, coarser = np.zeros((1, 1)), 1
    for halving in reversed(halvings):
        step = 2**halving
        start_m = z[::step, ::step]
        change_m = (
            _finer(change_m, start_m.shape, coarser / step, rng) if coarser > 1 else 0 * start_m
        )
        coarser = step
        if max(start_m.shape) > FINEST_PX:
            continue
        index = min(halving, len(STEPS) - 1)
        age = config.age * AGES[index] / (1 if index < len(STEPS) - 1 else len(halvings) - index)
        result = erode(
            start_m + change_m + grain(start_m.shape, GRAIN * step * spacing_m, rng),
            step * spacing_m,
            replace(erosion, age=age),
            rng,
            steps=STEPS[index],
            lift_m=lift_m[::step, ::step],
        )
        change_m = result.elevation_m - start_m
    return z + change_m


def _beds(z: FloatArray, config: ErosionConfig, rng: np.random.Generator) -> Beds | None:
    if config.beds is None:
        return None
    beds = config.beds
    return draw_beds(
        rng,
        float(z.min()),
        max(float(np.ptp(z)), 1e-3),
        count=beds.count,
        contrast=beds.contrast,
        repose_deg=(config.repose_deg, beds.repose_deg),
        hard_share=beds.hard_share,
    )


def _lift(
    size_px: int, extent_m: float, config: ErosionConfig, rng: np.random.Generator
) -> FloatArray:
    if config.beds is None:
        return np.zeros((size_px, size_px))
    dip = tangent(config.beds.dip_deg)
    return draw_lift(size_px, extent_m, rng, dip, 0.2 * dip * extent_m)


def _finer(
    change_m: FloatArray, shape: tuple[int, ...], factor: float, rng: np.random.Generator
) -> FloatArray:
    """Return a coarser grid's change on a finer one, whose cells are ``factor`` times as many.

    Places are shifted by noise, so that valleys bend whose segments followed the coarse grid.
    """
    rows, cols = shape
    shifts = bend_shifts(max(shape), BEND_CELLS * factor, BEND, rng)
    row = np.arange(rows)[:, None] / factor + shifts[0][:rows, :cols]
    col = np.arange(cols)[None, :] / factor + shifts[1][:rows, :cols]
    at = np.stack((row, col))
    return np.asarray(scipy.ndimage.map_coordinates(change_m, at, order=3, mode="nearest"))


def _with_means_of(before_m: FloatArray, after_m: FloatArray, pixel: float) -> FloatArray:
    """Return the heights after erosion with the means that each pixel had before.

    Args:
        before_m, after_m: (rows, cols) heights.
        pixel: Edge of the model's pixels in cells.
    """
    change_m = after_m - before_m
    counts = [int(np.ceil(size / pixel)) for size in before_m.shape]
    place = [np.minimum((np.arange(n) / pixel).astype(int), c - 1)
             for n, c in zip(before_m.shape, counts, strict=True)]  # fmt: skip
    label = (place[0][:, None] * counts[1] + place[1][None, :]).ravel()
    cells = np.maximum(np.bincount(label, minlength=counts[0] * counts[1]), 1)
    centres = [(np.arange(n) + 0.5) / pixel - 0.5 for n in before_m.shape]
    at = np.stack(np.meshgrid(*centres, indexing="ij"))
    for _ in range(MEAN_ROUNDS):
        means_m = (np.bincount(label, change_m.ravel(), len(cells)) / cells).reshape(counts)
        change_m -= scipy.ndimage.map_coordinates(means_m, at, order=1, mode="nearest")
    return before_m + change_m
