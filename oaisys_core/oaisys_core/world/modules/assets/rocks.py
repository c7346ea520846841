"""Draws the rocks of `assets.rocks`: their meshes, sizes and poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.assets import RockGroupConfig
from oaisys_core.config.sections.groups import MAX_INSTANCES
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.scatter.abundance import rock_abundance
from oaisys_core.procedural.scatter.placement.random_poses import power_law_sizes, scatter_on
from oaisys_core.procedural.scatter.rock_families import family_density, fragment_share
from oaisys_core.procedural.scatter.rocks import make_rock
from oaisys_core.scene import Ground, MeshPrototype, PbrMaps
from oaisys_core.types import FloatArray

LARGE_ROCK_M = 1.5
"""Rocks of groups with larger sizes than this have four times as many triangles."""


def rock_shapes(
    group: RockGroupConfig, maps: PbrMaps | None, rng: np.random.Generator
) -> list[MeshPrototype]:
    """Return the meshes of a group's rocks, each 1 m along its longest axis."""
    subdivisions = 4 if group.size_m[1] > LARGE_ROCK_M else 3
    return [
        replace(make_rock(group.kind, rng, subdivisions), maps=maps) for _ in range(group.variants)
    ]


def rock_sizes_m(
    group: RockGroupConfig, factor: float, ground: Ground, rng: np.random.Generator
) -> FloatArray:
    """Return the sizes of a group's rocks, by its number or by the ground that they cover.

    Raises:
        InvalidInputError: More than `MAX_INSTANCES` rocks would cover so much ground.
    """
    if group.cover is None:
        least, most = group.count
        count = min(round(factor * int(rng.integers(least, most, endpoint=True))), MAX_INSTANCES)
        return power_law_sizes(count, group.size_m, group.size_exponent, rng)
    rocks = rock_abundance(float(rng.uniform(*group.cover)), group.size_m)
    x0, y0, x1, y1 = ground.extent_m
    count = round(factor * rocks.per_m2 * (x1 - x0) * (y1 - y0))
    if count > MAX_INSTANCES:
        expected = f"a larger smallest size: {count} rocks are more than {MAX_INSTANCES}"
        raise InvalidInputError("assets.rocks[].size_m", list(group.size_m), expected)
    return rocks.draw(count, rng)


def rock_poses(
    group: RockGroupConfig,
    sizes_m: FloatArray,
    ground: Ground,
    shapes: list[MeshPrototype],
    rng: np.random.Generator,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the (N, 4, 4) poses with scale of a group's rocks, of up to (M,) sizes.

    Beside them are (N,) indices into ``shapes``.
    """
    T_map_object, _, shape_of = scatter_on(
        ground,
        sizes_m,
        rng,
        sink=group.sink,
        max_slope_deg=group.max_slope_deg,
        fragments=fragment_share(group.kind),
        preference=family_density(group.kind, ground),
        shapes=shapes,
    )
    return T_map_object, shape_of
