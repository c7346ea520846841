"""Swards: how kinds of grass and herbs stand on a tile, and their maps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures import fields
from oaisys_core.procedural.textures.baking.blades import (
    Blades,
    BladeView,
    Outline,
    blades_as_one,
    grass_outline,
    leaflet_outline,
    texels_at,
)
from oaisys_core.procedural.textures.baking.ground import sky_share, wide_blur
from oaisys_core.procedural.textures.recipes.finish import (
    Color,
    TextureMaps,
    blend,
    linear_to_srgb,
    scale_to_albedo,
    smoothstep,
)
from oaisys_core.types import FloatArray

Range = tuple[float, float]
"""Least and largest value of an even distribution."""

STRAW: tuple[Color, ...] = (
    (0.33, 0.26, 0.155),
    (0.26, 0.20, 0.12),
    (0.40, 0.33, 0.21),
    (0.18, 0.14, 0.09),
    (0.29, 0.25, 0.18),
)
"""Linear reflectance of withered blades, which rises towards red without an edge, as that of dry
litter does (G. Asner, "Biophysical and biochemical sources of variability in canopy reflectance",
Remote Sens. Environ. 64, 1998)."""

SHEATH: Color = (0.20, 0.19, 0.10)
"""Linear reflectance of a blade's foot."""

ALBEDO = 0.13
"""Mean luminance, that of the patch "foliage" of the chart by C. McCamy, H. Marcus and J. Davidson,
"A color-rendition chart", J. Appl. Photogr. Eng. 2, 1976: 13.3 %."""

SIDEWAYS = 0.45
"""Share of the way by which the wind turns a blade to its own direction."""


class Blade(NamedTuple):
    """A kind of blade; lengths in metres, angles in radians.

    Attributes:
        per_m2: Blades on a square metre where it is at its densest.
        length_m, width_m: Of a blade.
        lean: Of its foot from the vertical.
        droop: How much further its tip leans.
        colors: Linear reflectance.
        tuft_m: Standard deviation of the places of a tuft's blades; 0: each stands alone.
        per_tuft: Blades of a tuft.
        dry: Share of withered blades.
        low_m: Height of its feet.
        outline, segments: See `Blades`.
    """

    per_m2: float
    length_m: Range
    width_m: Range
    lean: Range
    droop: Range
    colors: tuple[Color, ...]
    tuft_m: float = 0.0
    per_tuft: int = 1
    dry: float = 0.0
    low_m: Range = (0.0, 0.0)
    outline: Outline = grass_outline
    segments: int = 4


class Plot(NamedTuple):
    """Where a kind grows.

    Attributes:
        tile_m: Edge length of the tile.
        ground: (N, N) height in tile edges.
        wind: (M, M) heading in which blades are blown.
        density: (M, M) probability, 0 to 1, that a tuft grows.
        bright: (M, M) logarithm of the brightness of what grows.
    """

    tile_m: float
    ground: Field
    wind: Field
    density: Field
    bright: Field


class Crop(NamedTuple):
    """Blades and their (B, 3) linear colours."""

    blades: Blades
    colors: NDArray[np.float32]


def grow(kind: Blade, plot: Plot, rng: np.random.Generator) -> Crop:
    """Return the blades of a kind, which lean away from the middle of their tuft."""
    together = blades_as_one(sum(kind.width_m) / 2 / plot.tile_m, len(plot.ground))
    centre = _places(kind.per_m2 / kind.per_tuft / together, plot, rng)
    tufts, count = len(centre), len(centre) * kind.per_tuft
    vigour, hue, color = (
        np.repeat(each, kind.per_tuft)
        for each in (
            rng.uniform(0.6, 1.0, tufts),
            rng.normal(0, 0.10, tufts),
            rng.integers(len(kind.colors), size=tufts),
        )
    )
    away = rng.normal(0, 1, (count, 2))
    root = np.repeat(centre, kind.per_tuft, axis=0) + away * (kind.tuft_m / plot.tile_m)
    row, column = texels_at(root, len(plot.ground))
    heading = rng.uniform(-np.pi, np.pi, count)
    lean = rng.uniform(*kind.lean, count)
    if kind.tuft_m:
        heading = np.arctan2(away[:, 0], away[:, 1]) + rng.normal(0, 0.7, count)
        lean *= 0.6 + 0.4 * np.hypot(away[:, 0], away[:, 1]).clip(0, 2)
    heading += SIDEWAYS * _turn(plot.wind[texels_at(root, len(plot.wind))] - heading)
    blades = Blades(
        np.column_stack(
            (root, plot.ground[row, column] + rng.uniform(*kind.low_m, count) / plot.tile_m)
        ),
        heading,
        rng.uniform(*kind.length_m, count) / plot.tile_m * vigour,
        together * rng.uniform(*kind.width_m, count) / plot.tile_m,
        lean,
        rng.uniform(*kind.droop, count),
        rng.normal(0, 0.35, count),
        kind.outline,
        kind.segments,
    )
    color = np.where(
        rng.uniform(size=count) < 0.6, color, rng.integers(len(kind.colors), size=count)
    )
    tone = (
        np.array(kind.colors)[color]
        * np.exp(_brightness(root, plot) + hue + rng.normal(0, 0.16, count))[:, None]
    )
    withered = rng.uniform(size=count) < kind.dry
    tone[withered] = np.array(STRAW)[rng.integers(len(STRAW), size=int(withered.sum()))]
    return Crop(blades, tone.astype(np.float32))


def grow_clover(
    per_m2: float, height_m: Range, colors: tuple[Color, ...], plot: Plot, rng: np.random.Generator
) -> Crop:
    """Return leaves of white clover: three leaflets of 6 to 14 mm on a stalk, which is not seen."""
    centre = _places(per_m2, plot, rng)
    leaves, count = len(centre), 3 * len(centre)
    row, column = texels_at(centre, len(plot.ground))
    high = plot.ground[row, column] + rng.uniform(*height_m, leaves) / plot.tile_m
    length = np.repeat(rng.uniform(0.006, 0.014, leaves), 3) / plot.tile_m
    heading = rng.uniform(-np.pi, np.pi, (leaves, 1)) + np.arange(3) * (2 * np.pi / 3)
    tone = np.array(colors)[rng.integers(len(colors), size=leaves)]
    tone *= np.exp(_brightness(centre, plot)[:, None] + rng.normal(0, 0.15, (leaves, 1)))
    blades = Blades(
        np.repeat(np.column_stack((centre, high)), 3, axis=0),
        heading.reshape(-1),
        length,
        0.85 * length,
        rng.uniform(1.2, 1.6, count),
        rng.uniform(-0.1, 0.3, count),
        np.zeros(count),
        leaflet_outline,
        5,
    )
    return Crop(blades, np.repeat(tone, 3, axis=0).astype(np.float32))


def sward_maps(
    view: BladeView,
    colors: NDArray[np.float32],
    ground: Field,
    earth: NDArray[np.float32],
    tile_m: float,
    *,
    extinction_per_m: float,
    relief: float,
) -> TextureMaps:
    """Return the maps of blades over earth.

    Args:
        view: What is seen of the blades.
        colors: (B, 3) linear, of each blade.
        ground: (N, N) height in tile edges.
        earth: (N, N, 3) linear colour.
        tile_m: Edge length of the tile.
        extinction_per_m: See `_light_within`.
        relief: Share of the blades' heights in the height map: a height field has no gaps below
            blades, and would be a cliff at each of their edges.
    """
    is_blade = view.height > ground
    light = (0.62 + 0.38 * view.facing) * _across(view)
    color = blend(colors[view.ids], SHEATH, 0.5 * smoothstep(0.22, 0.0, view.along))
    color *= light[..., None]
    color = np.where(is_blade[..., None], color, earth)
    height = np.where(is_blade, view.height, ground)
    shade = _light_within(height, tile_m, extinction_per_m)
    color *= (shade * sky_share(height, (0.003 / tile_m, 0.008 / tile_m)))[..., None]
    scale_to_albedo(color, ALBEDO)
    mean = wide_blur(height, 0.008 / tile_m * len(height))
    height = np.float32(relief) * (fields.blur(height, 0.7) + 2 * mean)
    rough = np.where(is_blade, 0.62, 0.95).astype(np.float32)
    return TextureMaps(linear_to_srgb(color), height.astype(np.float32), rough)


def _across(view: BladeView) -> Field:
    """Return the (N, N) brightness across blades: folded along a rib, which is paler."""
    turned = np.where(view.ids % 2, np.float32(0.10), np.float32(-0.10))
    rib = np.float32(0.10) * np.exp(-np.square(view.across / np.float32(0.25)))
    return np.asarray(1 + turned * view.across + rib, np.float32)


def _light_within(height: Field, tile_m: float, extinction_per_m: float) -> Field:
    """Return the (N, N) share of light below the tops around a place.

    M. Monsi and T. Saeki, "Über den Lichtfaktor in den Pflanzengesellschaften", Jpn. J. Bot. 14,
    1953: light falls exponentially with the area of leaves above; 0.3 to 0.5 of it for grass.

    Args:
        height: (N, N) in tile edges.
        tile_m: Edge length of the tile.
        extinction_per_m: Area of leaves in a metre of height, times that factor.
    """
    above = wide_blur(height, 0.015 / tile_m * len(height)) - height
    depth_m = np.maximum(above * np.float32(tile_m) + np.float32(0.3 / extinction_per_m), 0)
    return np.asarray(np.exp(np.float32(-extinction_per_m) * depth_m), np.float32)


def _places(per_m2: float, plot: Plot, rng: np.random.Generator) -> FloatArray:
    """Return (T, 2) rows and columns, in tile edges."""
    number = round(per_m2 * plot.tile_m**2)
    centre = rng.uniform(0, 1, (number, 2))
    return centre[rng.uniform(size=number) < plot.density[texels_at(centre, len(plot.density))]]


def _brightness(places: FloatArray, plot: Plot) -> Field:
    """Return the (B,) logarithms of brightness at (B, 2) places."""
    return np.asarray(plot.bright[texels_at(places, len(plot.bright))])


def _turn(angle: FloatArray) -> FloatArray:
    """Return angles between -pi and pi."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
