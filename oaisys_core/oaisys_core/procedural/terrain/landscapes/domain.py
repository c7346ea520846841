"""The ground on which processes run: wider than the stage, and cut to it in the end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from oaisys_core.procedural.terrain.landform import GroundSpec
from oaisys_core.procedural.terrain.noise import fractal, grid, warp
from oaisys_core.procedural.terrain.processes.exact import draw_direction
from oaisys_core.types import FloatArray

MARGIN = 1.25
"""Edge of the domain in edges of the stage, so that none of its borders is on the stage."""

FINEST_PX, COARSEST_PX = 769, 97
"""Grid sizes at which processes end, on large grids, and begin."""


@dataclass(frozen=True)
class Domain:
    """A square ground around that of a stage.

    Attributes:
        extent_m: Edge length.
        sizes_px: Sizes of its grids, each with half the spacing of the one before.
    """

    extent_m: float
    sizes_px: tuple[int, ...]

    @property
    def finest_px(self) -> int:
        """Size of its finest grid."""
        return self.sizes_px[-1]

    def spacing_m(self, size_px: int) -> float:
        """Return the distance between the cells of a grid."""
        return self.extent_m / (size_px - 1)

    def at_size(self, field: FloatArray, size_px: int) -> FloatArray:
        """Return every n-th value of a field on the finest grid."""
        step = (self.finest_px - 1) // (size_px - 1)
        return field[::step, ::step]

    def axis(self, size_px: int) -> FloatArray:
        """Return (size_px,) places along an edge, in edges of the domain from its centre."""
        return np.linspace(-0.5, 0.5, size_px)

    def noise(
        self,
        waves: float,
        rng: np.random.Generator,
        *,
        octaves: int,
        gain: float = 0.5,
        kind: str = "fbm",
        bend: float = 0.3,
    ) -> FloatArray:
        """Return (finest_px, finest_px) fractal noise with cells of an edge over ``waves``."""
        x, y = grid(waves, self.finest_px, 1.0)
        if bend:
            x, y = warp(x, y, rng, bend, octaves=2)
        return fractal(x, y, rng, octaves=octaves, gain=gain, kind=kind).astype(np.float64)

    def slope(self, rng: np.random.Generator) -> FloatArray:
        """Return (finest_px, finest_px) a plane of a drawn direction, -1 to 1 on most of it."""
        east, north = draw_direction(rng)
        axis = 2 * self.axis(self.finest_px)
        return np.asarray(axis[None, :] * east + axis[:, None] * north)

    def cut(self, field: FloatArray, spec: GroundSpec) -> FloatArray:
        """Return the (resolution_px, resolution_px) field on the stage, by cubic splines."""
        last = len(field) - 1
        half = 0.5 * spec.extent_m / self.extent_m
        index = (0.5 + np.linspace(-half, half, spec.resolution_px)) * last
        at = np.stack(np.meshgrid(index, index, indexing="ij"))
        return np.asarray(scipy.ndimage.map_coordinates(field, at, order=3, mode="nearest"))


def domain_of(spec: GroundSpec, margin: float = MARGIN) -> Domain:
    """Return the domain of a stage; coarse stages have coarse ones, of the same forms."""
    sizes = [COARSEST_PX]
    while sizes[-1] < min(spec.resolution_px, FINEST_PX):
        sizes.append(2 * sizes[-1] - 1)
    return Domain(spec.extent_m * margin, tuple(sizes))


def stages_of(
    domain: Domain, plan: tuple[tuple[int, float], ...]
) -> Iterator[tuple[int, int, float]]:
    """Yield grid size, steps and age of each part of a plan, from the coarsest grid on."""
    for size_px, (steps, age) in zip(domain.sizes_px, plan, strict=False):
        yield size_px, steps, age
