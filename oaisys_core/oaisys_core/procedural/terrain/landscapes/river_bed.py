"""A river bed between terraces: cut banks, point bars, scrolls, old arms."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.landform import (
    Elevation,
    GroundSpec,
    relief_or,
    subtract_median,
    unevenness,
)
from oaisys_core.procedural.terrain.landscapes.domain import Domain, domain_of
from oaisys_core.procedural.terrain.noise import fractal, grid
from oaisys_core.procedural.terrain.processes.bedrock import lay_talus
from oaisys_core.procedural.terrain.processes.evolution import Erosion, erode
from oaisys_core.procedural.terrain.processes.exact import draw_direction, tangent
from oaisys_core.procedural.terrain.processes.river import (
    POINTS,
    RiverBed,
    blocks_near,
    channel_depth,
    channel_of,
    even,
    wander,
)
from oaisys_core.procedural.terrain.processes.slopes import diffuse, slide, wear_back
from oaisys_core.types import FloatArray

WIDTH = 0.12
"""Width of the channel in edges of the stage."""

OLD_STEPS, STEPS, PAINTED = 110, 60, 4
"""Steps in which the river wanders: before it cuts down, and while it does; and every how many of
these it is drawn into the ground."""

BARS = 2.2
"""Distance from the middle line up to which bars lie, in half widths."""

RATE = 0.10
GRADIENT = 0.004
BANK_DEG, SLUMPED_DEG = 52.0, 30.0
"""Slopes of firm banks, and of those that have fallen."""

SLIDES = 8

RAGGED = ((7.0, 0.22), (30.0, 0.14))
"""Waves across the ground, and amplitudes in half the river's width, by which its banks bend."""

MOST_CELLS = 48
"""Cells from its foot up to which a bank wears back, at most."""

FOOT = 0.8
"""Height of the walls below which debris lies, in the relief."""


def river_bed(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """A gravel bed that has cut down while it wandered."""
    domain = domain_of(spec)
    relief_m = relief_or(spec, 0.035 * spec.extent_m)
    width_m, depth_m = WIDTH * spec.extent_m, 0.3 * relief_m
    east, north = draw_direction(rng)
    axis = domain.axis(domain.finest_px) * domain.extent_m
    along_m = axis[None, :] * east + axis[:, None] * north
    across_m = axis[:, None] * east - axis[None, :] * north
    ragged = sum(
        (height * domain.noise(waves, rng, octaves=4) for waves, height in RAGGED),
        np.zeros((domain.finest_px, domain.finest_px)),
    )
    z = relief_m * (0.75 + 0.12 * domain.noise(5.0, rng, octaves=5))
    far = np.clip(np.abs(across_m) / (0.5 * domain.extent_m) - 0.3, 0.0, None)
    z = z + relief_m * 2.2 * far**2 * (1.0 + 0.6 * domain.noise(3.0, rng, octaves=4))
    line = _first_line(domain, width_m, rng)
    reach_m = 0.5 * width_m * BARS / (1.0 + float(ragged.min())) + POINTS * width_m
    for _ in range(OLD_STEPS):
        line = wander(line, width_m, RATE)
    for step in range(STEPS + 1):
        if step % PAINTED == 0:
            level_m = 0.75 * relief_m * (1.0 - step / STEPS)
            near = blocks_near(line, reach_m, along_m, across_m)
            channel = channel_of(line, width_m, along_m[near], across_m[near])
            z[near] = _paint(z[near], channel, ragged[near], depth_m, level_m, rng)
        if step < STEPS:
            line = wander(line, width_m, RATE)
    z = _weather(z, domain, relief_m, rng)
    z = z - GRADIENT * along_m
    return subtract_median(domain.cut(z, spec) + spec.roughness * 0.12 * unevenness(spec, rng))


def _first_line(domain: Domain, width_m: float, rng: np.random.Generator) -> FloatArray:
    """Return the middle line of a river that has hardly wandered."""
    half_m = 0.9 * domain.extent_m
    x = np.arange(-half_m, half_m, 0.35 * width_m)
    noise = fractal((x / (5.0 * width_m))[None, :], np.zeros((1, 1)), rng, octaves=2)[0]
    return even(np.stack((x, 1.6 * width_m * noise), axis=1).astype(np.float64), 0.35 * width_m)


def _paint(
    z: FloatArray,
    channel: RiverBed,
    ragged: FloatArray,
    depth_m: float,
    level_m: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the ground with the channel of one time cut into it, and the bars that it leaves.

    Args:
        z: (N,) heights of places near the river.
        channel: Where these places lie beside it.
        ragged: (N,) by how much its banks bend there, in half widths.
        depth_m: Mean depth of the channel.
        level_m: Height of its banks.
        rng: Draws the height of the bars.
    """
    off = np.abs(channel.across) * (1.0 + ragged)
    ground_m = level_m - depth_m * channel_depth(channel, 0.55)
    # Beside the bed, the bars of this time: lower than the banks, rising away from the water.
    bar_m = level_m - depth_m * np.clip(0.9 - 0.55 * (off - 1.0), 0.0, 0.9)
    bar_m = bar_m + 0.12 * depth_m * float(rng.uniform(-1.0, 1.0))
    inner = channel.bend * channel.across > 0.05
    bars = np.where((off < 1.0), ground_m, np.where(inner & (off < BARS), bar_m, np.inf))
    return np.asarray(np.where(off < 1.0, np.minimum(z, ground_m), np.minimum(z, bars)))


def _weather(
    z: FloatArray, domain: Domain, relief_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return the ground with banks that have fallen, gullies in them, and gravel sheets."""
    spacing_m = domain.spacing_m(domain.finest_px)
    x, y = grid(domain.extent_m / (0.35 * relief_m), domain.finest_px, 1.0)
    z = z + 0.02 * relief_m * fractal(x, y, rng, octaves=4, gain=0.6)
    firmness = np.clip(0.5 + 1.2 * domain.noise(12.0, rng, octaves=4), 0.0, 1.0)
    slumped, firm = tangent(SLUMPED_DEG), tangent(BANK_DEG)
    reach = min(int(np.ceil(relief_m / (slumped * spacing_m))), MOST_CELLS)
    gentle_m, steep_m = (wear_back(z, spacing_m, slope, reach) for slope in (slumped, firm))
    z = gentle_m + (steep_m - gentle_m) * firmness
    z = lay_talus(z, spacing_m, FOOT * relief_m, rng)
    z = slide(z, spacing_m, slumped + (firm - slumped) * firmness, SLIDES)
    gullies = Erosion(age=0.002, deposition=0.8, repose_deg=BANK_DEG)
    z = erode(z, spacing_m, gullies, rng, steps=3).elevation_m
    return diffuse(z, spacing_m, 0.15 * spacing_m**2)
