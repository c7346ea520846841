"""Stones that lie on layers of the ground: patches of stones that stand out of a texture.

Stones have the colours of the layer's texture, and sizes of its law, so that they go on with what
the texture shows.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from oaisys_core.color import linear, srgb
from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.procedural.scatter.rocks import CREASE_RAD, fine_rock
from oaisys_core.procedural.textures.baking.sizes import (
    PowerLaw,
    RosinRammler,
    SizeLaw,
    draw_diameters,
)
from oaisys_core.scene import MeshPrototype, PbrMaps
from oaisys_core.types import FloatArray

SHAPES = 10
"""Shapes of stones of a patch."""

COARSE_M = 0.045
"""Size from which a stone has 320 triangles instead of 80."""

TILT_DEG = 18.0
"""Standard deviation of the angle between a stone's base and the ground."""

TRIES = 6
"""Places that are tried for a stone that would lie in others."""

APART = 0.42
"""Least distance of two stones, in sums of their sizes: they may touch."""

SAMPLED_PX, HIGH = 256, 0.6
"""Places along an edge of the texture of which colours are taken, and the rank of heights from
which on they are."""

UNEVEN = 0.06
"""Standard deviation of the logarithm of the brightness over a stone."""


class StonePatch(NamedTuple):
    """A patch of stones that many instances share; sizes are in metres.

    Attributes:
        per_m2: Instances where the layer covers all of the ground.
        width_m: (least, largest) width of the patch.
        clumping: How much they lie in clumps: 0 anywhere, 1 only in the best half of places.
        kind: Of the stones, see `rocks.ROCK_KINDS`.
        cover: Share of the patch that they cover.
        size_m: (least, largest) size of a stone.
        law: Of their sizes: that of the texture.
        sink: (least, largest) share of its height by which a stone is sunk.
        max_slope_deg: Steepest ground on which it lies.
    """

    per_m2: float
    width_m: tuple[float, float]
    clumping: float
    kind: str
    cover: float
    size_m: tuple[float, float]
    law: SizeLaw
    sink: tuple[float, float] = (0.1, 0.5)
    max_slope_deg: float = 38.0


SMALL, WIDE = (0.75, 0.95), (0.8, 1.2)
"""Widths of patches."""

CRUSHED, SORTED, IMPACTS = RosinRammler(0.035, 0.9), RosinRammler(0.034, 1.6), PowerLaw(2.1)

_BROKEN = (
    StonePatch(3.0, SMALL, 0.2, "angular", 0.18, (0.018, 0.07), CRUSHED),
    StonePatch(0.8, WIDE, 0.7, "angular", 0.14, (0.05, 0.14), CRUSHED),
)

LOOSE_STONES: dict[str, tuple[StonePatch, ...]] = {
    "gravel": _BROKEN,
    "gravel_dark": _BROKEN,
    "pebbles": (
        StonePatch(3.5, SMALL, 0.1, "pebble", 0.22, (0.02, 0.08), SORTED),
        StonePatch(0.8, WIDE, 0.5, "rounded", 0.14, (0.05, 0.14), SORTED),
    ),
    "soil": (StonePatch(1.5, WIDE, 0.7, "angular", 0.025, (0.016, 0.08), RosinRammler(0.02, 0.8)),),
    "regolith": (StonePatch(1.5, WIDE, 0.6, "angular", 0.03, (0.016, 0.14), IMPACTS),),
    "red_sand": (StonePatch(1.0, WIDE, 0.9, "angular", 0.03, (0.016, 0.1), CRUSHED),),
    "lava": (StonePatch(1.2, WIDE, 0.6, "angular", 0.07, (0.02, 0.14), CRUSHED),),
    "basalt": (StonePatch(1.2, WIDE, 0.9, "angular", 0.07, (0.02, 0.14), CRUSHED),),
    "bedrock": (StonePatch(1.2, WIDE, 0.9, "angular", 0.07, (0.02, 0.14), CRUSHED),),
    "rock": (StonePatch(1.2, WIDE, 0.9, "angular", 0.07, (0.02, 0.14), CRUSHED),),
}
"""Patches by name of the texture that they lie on. Larger stones are rocks (``assets.rocks``)."""


def make_stone_patch(
    name: str, patch: StonePatch, linear_colors: FloatArray, rng: np.random.Generator
) -> MeshPrototype:
    """Return a patch of stones that is 1 m wide; the ground is at z = 0.

    Args:
        name: Of the mesh.
        patch: Its form.
        linear_colors: (N, 3) linear colours of its stones, as of `stone_colors`.
        rng: Draws it.
    """
    from scipy.spatial.transform import Rotation

    width_m = float(np.mean(patch.width_m))
    area_m2 = np.pi / 4 * width_m**2
    sizes_m = draw_diameters(patch.law, patch.cover * area_m2, patch.size_m, rng)
    xy_m = _places(sizes_m, width_m, rng)
    shapes = [[fine_rock(patch.kind, rng, fine) for _ in range(SHAPES)] for fine in (1, 2)]
    count = len(sizes_m)
    turns = Rotation.from_euler("z", rng.uniform(-180, 180, (count, 1)), degrees=True)
    tilts = Rotation.from_rotvec(
        np.column_stack((rng.normal(0, TILT_DEG, (count, 2)), np.zeros(count))), degrees=True
    )
    shape_of, sink = rng.integers(SHAPES, size=count), rng.uniform(*patch.sink, count)
    colors = linear_colors[rng.integers(len(linear_colors), size=count)]
    parts = MeshBuilder()
    for stone, turn in enumerate((tilts * turns).as_matrix()):
        shape = shapes[int(sizes_m[stone] >= COARSE_M)][shape_of[stone]]
        points_m = sizes_m[stone] * shape.vertices_m.astype(np.float64) @ turn.T
        low, high = points_m[:, 2].min(), points_m[:, 2].max()
        points_m += (*xy_m[stone], -low - sink[stone] * (high - low))
        bright = np.exp(rng.normal(0, UNEVEN, (len(points_m), 1)))
        parts.add(points_m, shape.triangles, srgb(np.clip(bright * colors[stone], 0, 1)))
    mesh = parts.mesh(name)
    vertices_m = mesh.vertices_m.astype(np.float64) / width_m
    return replace(mesh, vertices_m=vertices_m.astype(np.float32), crease_rad=CREASE_RAD)


def stone_colors(maps: PbrMaps) -> FloatArray:
    """Return (N, 3) linear colours of what stands out of a texture."""
    half = max(len(maps.color_srgb) // (2 * SAMPLED_PX), 1)
    texels = linear(maps.color_srgb[::half, ::half] / 255)
    count = len(texels) // 2
    # Means of four texels: finer grain is not the colour of a stone.
    colors = texels[: 2 * count, : 2 * count].reshape(count, 2, count, 2, 3).mean(axis=(1, 3))
    height = maps.height[:: 2 * half, :: 2 * half][:count, :count]
    return np.asarray(colors[height >= np.quantile(height, HIGH)])


def _places(sizes_m: FloatArray, width_m: float, rng: np.random.Generator) -> FloatArray:
    """Return (N, 2) places of stones of (N,) sizes, which mostly do not lie in each other."""
    xy_m = np.zeros((len(sizes_m), 2))
    for stone, size_m in enumerate(sizes_m):
        far = (width_m / 2 - size_m / 2) * np.sqrt(rng.uniform(size=TRIES))
        # Fewer at the rim, where patches overlap.
        far *= 0.6 + 0.4 * rng.uniform(size=TRIES)
        angle = rng.uniform(0, 2 * np.pi, TRIES)
        tries = far[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))
        gaps_m = np.linalg.norm(tries[:, None] - xy_m[:stone], axis=-1)
        gaps_m -= APART * (sizes_m[:stone] + size_m)
        xy_m[stone] = tries[gaps_m.min(axis=1, initial=1.0).argmax()]
    return xy_m
