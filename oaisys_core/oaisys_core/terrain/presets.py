"""Kinds of terrain by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.scene import HeightField
from oaisys_core.terrain.noise import fractal, grid, warped

Elevation = NDArray[np.float32]


@dataclass(frozen=True)
class GroundSpec:
    """What is asked of a preset.

    Attributes:
        extent_m: Edge length.
        resolution_px: Grid points along an edge.
        roughness: Factor on the fine unevenness.
        relief_m: Height of the large forms; None: the preset's own.
    """

    extent_m: float
    resolution_px: int
    roughness: float = 1.0
    relief_m: float | None = None


Preset = Callable[[GroundSpec, np.random.Generator], Elevation]
"""To (resolution_px, resolution_px) float32 metres."""


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
        rng: Gives its shape.
        roughness: Factor on the fine unevenness.
        relief_m: Difference between lowest and highest point of the large forms; None: the
            preset's own.

    Raises:
        InvalidInputError: There is no preset of that name.
    """
    if preset not in PRESETS:
        raise InvalidInputError("stage.preset", preset, f"one of {', '.join(sorted(PRESETS))}")
    spec = GroundSpec(extent_m, resolution_px, roughness, relief_m)
    elevation_m = PRESETS[preset](spec, rng)
    spacing_m = extent_m / (resolution_px - 1)
    return HeightField(elevation_m, (-extent_m / 2, -extent_m / 2), spacing_m)


def plane(spec: GroundSpec, _rng: np.random.Generator) -> Elevation:
    """Exactly flat, at z = 0."""
    return np.zeros((spec.resolution_px, spec.resolution_px), np.float32)


def mounds(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Rolling, uneven ground: mounds and hollows some metres wide, lumps and ruts on them."""
    x, y = grid(spec.extent_m, spec.resolution_px, cell=22.0)
    x, y = warped(x, y, rng, strength=0.35)
    rolling = fractal(x, y, rng, octaves=3, gain=0.45)
    large = _scaled(rolling, 4.5 if spec.relief_m is None else spec.relief_m)
    return _grounded(large + spec.roughness * _unevenness(spec, rng))


def mountain_1(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """One steep hill in the middle, with ridges and gullies down its flanks."""
    height_m = 0.25 * spec.extent_m if spec.relief_m is None else spec.relief_m
    axis = np.linspace(-1, 1, spec.resolution_px)
    u, v = np.meshgrid(axis, axis)
    x, y = grid(spec.extent_m, spec.resolution_px, cell=spec.extent_m / 3.5)
    wx, wy = warped(x, y, rng, strength=0.3)
    bend = fractal(x, y, rng, octaves=3)
    radius = np.hypot(u, v) * (1 + 0.3 * bend)
    cone = np.exp(-np.power(radius / 0.45, 1.5)).astype(np.float32)
    ridges = fractal(wx, wy, rng, octaves=6, kind="ridged", gain=0.42)
    hill = cone * (0.62 + 0.5 * ridges) + 0.02 * fractal(2 * x, 2 * y, rng, octaves=3)
    return _grounded(_scaled(hill, height_m) + spec.roughness * _unevenness(spec, rng))


def _unevenness(spec: GroundSpec, rng: np.random.Generator) -> Elevation:
    """Return what makes a ground rough underfoot: lumps of 2 m down to clods of 15 cm."""
    x, y = grid(spec.extent_m, spec.resolution_px, cell=2.6)
    patchy = 0.55 + 0.45 * fractal(x / 4, y / 4, rng, octaves=2)
    lumps = fractal(*warped(x, y, rng, 0.3, octaves=2), rng, octaves=2, kind="billow")
    clods = fractal(5 * x, 5 * y, rng, octaves=3, gain=0.6)
    rough = 0.60 * lumps + 0.11 * clods
    return np.asarray(rough * patchy, np.float32)


def _scaled(field: Elevation, relief_m: float) -> Elevation:
    low, high = float(field.min()), float(field.max())
    return np.asarray((field - low) * np.float32(relief_m / max(high - low, 1e-9)), np.float32)


def _grounded(elevation_m: Elevation) -> Elevation:
    """Return the field with its median height at z = 0."""
    return np.asarray(elevation_m - np.median(elevation_m), np.float32)


PRESETS: dict[str, Preset] = {"plane": plane, "mounds": mounds, "mountain_1": mountain_1}
