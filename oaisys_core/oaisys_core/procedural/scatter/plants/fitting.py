"""Scaling of plants to 1 m without scaling their leaves."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.scene import MeshPrototype

PlantBuilder = Callable[[np.random.Generator, float, float], MeshBuilder]
"""Returns a plant in units of any length, from the unit in metres, which may only change sizes, and
the plant's size in metres, which decides on numbers."""

PlantGenerator = Callable[[np.random.Generator, float], MeshPrototype]
"""Returns a plant scaled to 1 m, whose leaves suit a size in metres."""

PASSES, TOLERANCE = 6, 0.02
"""How often and how well the unit is fitted; seedlings below a leaf's size have smaller leaves."""


def fit_to_size(
    name: str, build: PlantBuilder, rng: np.random.Generator, size_m: float = 1.0
) -> MeshPrototype:
    """Return a plant scaled to 1 m along its longest axis, whose leaves suit a size in metres."""
    extent = 1.0
    for _ in range(PASSES):
        drawn = copy.deepcopy(rng)
        parts = build(drawn, size_m / extent, size_m)
        before, extent = extent, parts.extent
        if abs(extent / before - 1) < TOLERANCE:
            break
    rng.bit_generator.state = drawn.bit_generator.state
    return parts.mesh_of_size_1(name)
