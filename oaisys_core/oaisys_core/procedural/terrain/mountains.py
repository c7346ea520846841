"""Mountains and wide landscapes: ridged noise with valleys cut by erosion."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.erosion import slides, streams
from oaisys_core.procedural.terrain.landform import (
    Elevation,
    GroundSpec,
    refine,
    relief_or,
    scale_to_relief,
    subtract_median,
    unevenness,
)
from oaisys_core.procedural.terrain.noise import (
    LATTICE,
    Field,
    fractal,
    gradient_noise,
    grid,
    warp,
)
from oaisys_core.procedural.terrain.processes.bedrock import LARGEST_BLOCK_M, break_rock
from oaisys_core.procedural.terrain.processes.mantle import lay_mantle
from oaisys_core.types import FloatArray

ERODED_PX = 257
"""Grid size for erosion at any resolution, so that a seed always gives the same landscape."""

BLOCK = 0.17
"""Spacing of joints in the height of a mountain."""

MANTLE, MANTLE_DEG = (0.03, 0.015, 0.007), 35.0
"""Lengths in the height of a mountain by which soil and debris are smooth, and their repose."""


def mountain_1(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """One steep hill in the middle, with ridges and gullies down its flanks."""
    height_m = relief_or(spec, 0.25 * spec.extent_m)
    axis = np.linspace(-1, 1, spec.resolution_px)
    u, v = np.meshgrid(axis, axis)
    x, y = grid(spec.extent_m, spec.resolution_px, cell=spec.extent_m / 3.5)
    wx, wy = warp(x, y, rng, strength=0.3)
    bend = fractal(x, y, rng, octaves=3)
    radius = np.hypot(u, v) * (1 + 0.3 * bend)
    cone = np.exp(-np.power(radius / 0.45, 1.5)).astype(np.float32)
    ridges = fractal(wx, wy, rng, octaves=6, kind="ridged", gain=0.42)
    hill = cone * (0.62 + 0.5 * ridges) + 0.02 * fractal(2 * x, 2 * y, rng, octaves=3)
    rock_m = _with_joints_and_soil(spec, scale_to_relief(hill, height_m), height_m, rng)
    large_m = scale_to_relief(rock_m, height_m)
    return subtract_median(large_m + 0.6 * spec.roughness * unevenness(spec, rng))


def mountain_2(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """A range across the stage: sharp crests, valleys branching down to plains on both sides."""
    height_m = relief_or(spec, 0.22 * spec.extent_m)
    spacing_m = spec.extent_m / (ERODED_PX - 1)
    x, y = grid(spec.extent_m, ERODED_PX, cell=spec.extent_m / 3.0)
    wx, wy = warp(x, y, rng, strength=0.35)
    heading = rng.uniform(0, np.pi)
    across = (x - 1.5) * np.cos(heading) + (y - 1.5) * np.sin(heading)
    across = across + 0.35 * fractal(x, y, rng, octaves=2)
    envelope = np.exp(-np.square(across / 0.85))
    crests = fractal(wx, wy, rng, octaves=5, kind="ridged", gain=0.45)
    raw = scale_to_relief(
        envelope * (0.35 + crests) + 0.05 * fractal(x, y, rng, octaves=4), height_m
    )
    cut = streams(raw, spacing_m, rng, steps=50, strength=0.03)
    return _finish(spec, cut, height_m, rng)


def large_terrain(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """A wide landscape at reduced scale: hills, a mountain side and valleys with level floors."""
    height_m = relief_or(spec, 0.14 * spec.extent_m)
    spacing_m = spec.extent_m / (ERODED_PX - 1)
    x, y = grid(spec.extent_m, ERODED_PX, cell=spec.extent_m / 2.2)
    wx, wy = warp(x, y, rng, strength=0.3)
    land = fractal(wx, wy, rng, octaves=5, gain=0.5)
    heading = rng.uniform(0, 2 * np.pi)
    rise = (x - 1.1) * np.cos(heading) + (y - 1.1) * np.sin(heading)
    share = 1 / (1 + np.exp(-3 * (rise + 0.6 * fractal(x, y, rng, octaves=2))))
    crests = fractal(2 * wx, 2 * wy, rng, octaves=5, kind="ridged", gain=0.45)
    raw = scale_to_relief(0.45 * land + share * (0.25 + crests), height_m)
    cut = streams(raw, spacing_m, rng, steps=40, strength=0.03)
    low_m, high_m = np.quantile(cut, (0.02, 0.22))
    # Sediment from the heights levels the valley floors.
    silt_m = (high_m - low_m) * 0.6
    floor_m = low_m + silt_m
    cut = np.where(cut < floor_m + silt_m, _softly_above(cut, floor_m, silt_m), cut)
    return _finish(spec, cut, height_m, rng)


def another_noise(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Hybrid multifractal noise: smooth in the hollows, rough on the heights.

    After Musgrave, in "Texturing and Modeling: A Procedural Approach", 2003, chapter 16: each
    octave is weighted by the height of the coarser ones.
    """
    height_m = relief_or(spec, 0.12 * spec.extent_m)
    x, y = grid(spec.extent_m, spec.resolution_px, cell=spec.extent_m / 4.0)
    x, y = warp(x, y, rng, strength=0.25, octaves=2)
    total: Field = gradient_noise(x, y, rng) + np.float32(0.7)
    weight = total.copy()
    for octave in range(1, 7):
        scale = 2.0**octave
        weight = np.clip(weight, 0, 1)
        noise = gradient_noise(x * scale, y * scale, rng, LATTICE) + np.float32(0.7)
        signal = noise * np.float32(scale**-0.9)
        total += weight * signal
        weight = weight * signal * np.float32(2.2)
    return subtract_median(
        scale_to_relief(total, height_m) + spec.roughness * 0.7 * unevenness(spec, rng)
    )


def _finish(
    spec: GroundSpec, eroded_m: FloatArray, height_m: float, rng: np.random.Generator
) -> Elevation:
    """Return an eroded landscape at the resolution of the ground, with crags where it is high."""
    spacing_m = spec.extent_m / (ERODED_PX - 1)
    settled = slides(eroded_m, spacing_m, steps=12, repose_deg=48.0)
    large_m = scale_to_relief(refine(settled, spec.resolution_px), height_m)
    x, y = grid(spec.extent_m, spec.resolution_px, cell=spec.extent_m / 18.0)
    crags = fractal(x, y, rng, octaves=4, kind="ridged", gain=0.5)
    bare = np.clip(large_m / max(height_m, 1e-9) * 1.6 - 0.25, 0, 1)
    rocky_m = 0.06 * height_m * bare * (crags - 0.45)
    rock_m = _with_joints_and_soil(spec, large_m + rocky_m, height_m, rng)
    return subtract_median(rock_m + 0.6 * spec.roughness * unevenness(spec, rng))


def _with_joints_and_soil(
    spec: GroundSpec, large_m: Elevation, height_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return a mountain whose steep rock is broken into blocks, with soil on gentle slopes."""
    block_m = min(BLOCK * height_m, LARGEST_BLOCK_M)
    rock_m = break_rock(large_m.astype(np.float64), spec.spacing_m, block_m, rng)
    return lay_mantle(rock_m, spec.spacing_m, height_m, MANTLE, MANTLE_DEG)


def _softly_above(height_m: FloatArray, floor_m: float, soft_m: float) -> FloatArray:
    """Return the soft maximum of heights and a floor."""
    return np.asarray(
        floor_m + soft_m / 3 * np.logaddexp(0.0, 3 * (height_m - floor_m) / soft_m) - 0.016 * soft_m
    )
