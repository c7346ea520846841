"""Terrain presets by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oaisys_core import extensions
from oaisys_core.errors import InvalidInputError, one_of
from oaisys_core.procedural.terrain.ground_checks import HEIGHTS_EXPECTED, are_heights
from oaisys_core.procedural.terrain.landform import (
    Elevation,
    GroundSpec,
    Preset,
    scale_to_relief,
    subtract_median,
    unevenness,
    warn_of_relief,
)
from oaisys_core.procedural.terrain.landscapes.alpine import alpine
from oaisys_core.procedural.terrain.landscapes.badlands import badlands
from oaisys_core.procedural.terrain.landscapes.canyon import canyon
from oaisys_core.procedural.terrain.landscapes.crater_field import crater_field, deepest_m
from oaisys_core.procedural.terrain.landscapes.kept import make_once
from oaisys_core.procedural.terrain.landscapes.river_bed import river_bed
from oaisys_core.procedural.terrain.landscapes.slab_dunes import slab_dunes
from oaisys_core.procedural.terrain.landscapes.volcanic_field import volcanic_field
from oaisys_core.procedural.terrain.mountains import (
    another_noise,
    large_terrain,
    mountain_1,
    mountain_2,
)
from oaisys_core.procedural.terrain.noise import fractal, grid, warp
from oaisys_core.procedural.terrain.sculpted import craters, dunes, mesa
from oaisys_core.scene import HeightField


def make_ground(
    preset: str,
    extent_m: float,
    resolution_px: int,
    rng: np.random.Generator,
    roughness: float = 1.0,
    relief_m: float | None = None,
) -> HeightField:
    """Return a square ground centred on the origin.

    Args:
        preset: A name in `PRESETS`.
        extent_m: Edge length.
        resolution_px: Grid points along an edge.
        rng: Draws its shape.
        roughness: Factor on the fine unevenness.
        relief_m: Height difference of the large forms; None for the default of the preset.

    Raises:
        InvalidInputError: There is no preset of that name.
    """
    check_preset(preset)
    spec = GroundSpec(extent_m, resolution_px, roughness, relief_m)
    maker = PRESETS.get(preset) or extensions.load(extensions.STAGES, preset)
    if preset in SHAPED and relief_m is not None:
        # Processes divide by the relief.
        spec = replace(spec, relief_m=max(relief_m, LEAST_RELIEF * extent_m))
    if preset == "crater_field" and relief_m is not None:
        warn_of_relief(relief_m, extent_m, deepest_m(extent_m))  # also of a ground that is kept
    if preset in SHAPED or preset in ROCKY:
        elevation_m = make_once(preset, spec, rng, lambda: np.asarray(maker(spec, rng)))
    else:
        elevation_m = np.asarray(maker(spec, rng), np.float32)
    if elevation_m.shape != (resolution_px, resolution_px) or not are_heights(elevation_m):
        points = f"({resolution_px}, {resolution_px})"
        expected = f"{points} points of the stage {preset!r} with {HEIGHTS_EXPECTED}"
        raise InvalidInputError("stage.preset", elevation_m.shape, expected)
    spacing_m = extent_m / (resolution_px - 1)
    return HeightField(elevation_m, (-extent_m / 2, -extent_m / 2), spacing_m)


def check_preset(preset: str) -> None:
    """Raise if a preset is neither built in nor installed.

    Raises:
        InvalidInputError: There is no preset of that name.
    """
    if preset not in PRESETS and not extensions.is_installed(extensions.STAGES, preset, PRESETS):
        known = PRESETS.keys() | extensions.names(extensions.STAGES)
        raise InvalidInputError("stage.preset", preset, one_of(known, preset))


def plane(spec: GroundSpec, _rng: np.random.Generator) -> Elevation:
    """Exactly flat, at z = 0."""
    return np.zeros((spec.resolution_px, spec.resolution_px), np.float32)


def mounds(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Rolling ground: mounds and hollows some metres wide, with lumps and ruts."""
    x, y = grid(spec.extent_m, spec.resolution_px, cell=22.0)
    x, y = warp(x, y, rng, strength=0.35)
    rolling = fractal(x, y, rng, octaves=3, gain=0.45)
    large = scale_to_relief(rolling, 4.5 if spec.relief_m is None else spec.relief_m)
    return subtract_median(large + spec.roughness * unevenness(spec, rng))


LEAST_RELIEF = 1e-6
"""Relief of presets made by processes, at least, in edges of the stage."""

SHAPED: dict[str, Preset] = {
    "alpine": alpine,
    "badlands": badlands,
    "canyon": canyon,
    "crater_field": crater_field,
    "river_bed": river_bed,
    "slab_dunes": slab_dunes,
    "volcanic_field": volcanic_field,
}
"""Presets made by processes, which take seconds and are kept on disk."""

ROCKY: dict[str, Preset] = {
    "large_terrain": large_terrain,
    "mesa": mesa,
    "mountain_1": mountain_1,
    "mountain_2": mountain_2,
}
"""Presets of noise whose rock is broken along joints, which are kept on disk, too."""

PRESETS: dict[str, Preset] = {
    "another_noise": another_noise,
    "craters": craters,
    "dunes": dunes,
    "mounds": mounds,
    "plane": plane,
    **ROCKY,
    **SHAPED,
}
