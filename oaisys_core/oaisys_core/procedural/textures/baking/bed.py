"""A tile on which things are laid; the highest one is seen, as by rays from above."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.noise import Field
from oaisys_core.procedural.textures.baking.placements import (
    Placements,
    above_ground,
    leaning,
    turn_stamp,
)
from oaisys_core.procedural.textures.baking.stamps import OUTSIDE, MeshStamps
from oaisys_core.types import FloatArray

LARGE_PX = 12.0
"""Radius from which things are laid one by one, each onto those before."""

LEAST_PX = 0.5
"""Radius of the smallest things that are laid: smaller ones fall between the texels."""

CHUNK_PX = 400_000
"""Texels that smaller things are laid on at once; those of one chunk do not rest on each other."""

CLASS_RATIO = 1.3
"""Ratio of the radii within a class of sizes; things make room for those of larger classes."""

TRIES = 6
"""Places that are tried for a thing before it is left out."""

INSIDE = OUTSIDE / 2
"""Height of a stamp above which a texel is its own; outlines are mixed with what is outside."""

PROBES = np.array([(0.0, 0.0), *[(np.cos(a), np.sin(a)) for a in np.arange(6) * np.pi / 3]])
PROBED, MOST_COVERED = 0.65, 2
"""Points where a thing looks for others: its middle and six around it, at this share of its radius.
At most so many of them may be covered."""


class Laying(NamedTuple):
    """How things are laid.

    Attributes:
        flatness: Factor on the heights of their stamps.
        buried: Least and largest share of a thing's height that is below the ground.
        rest: Where it rests: 0 on the mean of the ground below it, 1 on its highest point.
        makes_room: Whether a thing looks for a place that larger ones leave.
        follows: Share of the slope below it by which it leans.
    """

    flatness: float = 1.0
    buried: tuple[float, float] = (0.2, 0.5)
    rest: float = 0.0
    makes_room: bool = True
    follows: float = 0.0


class Bed:
    """The surface of a tile to which things are added.

    Attributes:
        height: (N, N) float32 in tile edges.
        ids: (N, N) int64 index of the thing on top, -1 on bare ground.
        above: (N, N) float32 height above the ground below the thing, relative to its top; 0 on
            bare ground.
        classes: Placements of the things of each class of sizes.
    """

    def __init__(self, height: Field) -> None:
        self.height = np.array(height, np.float32, order="C")
        self.ids = np.full(height.shape, -1, np.int64)
        self.above = np.zeros(height.shape, np.float32)
        self.classes: list[Placements] = []

    @property
    def count(self) -> int:
        """Number of things so far."""
        return sum(len(each.centre) for each in self.classes)

    @property
    def placements(self) -> Placements:
        """Where all things lie; there is at least one."""
        return Placements(*(np.concatenate(part) for part in zip(*self.classes, strict=True)))

    def add(
        self,
        stamps: MeshStamps,
        diameters: FloatArray,
        laying: Laying,
        rng: np.random.Generator,
        density: Field | None = None,
    ) -> None:
        """Add things, the first ones first.

        Args:
            stamps: Their shapes.
            diameters: (P,) in tile edges, the largest first.
            laying: How they are laid.
            rng: Draws where they lie, and how.
            density: (N, N) probability, 0 to 1, that a place is taken; None takes all.
        """
        radii = diameters * (len(self.height) / 2)
        # A disc of the same area is smaller than the square that holds a shape.
        radii = radii * np.sqrt(np.pi / 4 / stamps.share.mean())
        radii = radii[radii >= LEAST_PX]
        first = 0
        while first < len(radii):
            end = int(np.searchsorted(-radii, -radii[first] / CLASS_RATIO, side="right"))
            centres, found = self._places(radii[first:end], laying, rng, density)
            radius = radii[first:end][found]
            number = len(centres)
            self._lay(
                stamps,
                Placements(
                    centres,
                    radius,
                    rng.uniform(0, 2 * np.pi, number),
                    rng.integers(len(stamps.top), size=number),
                    rng.uniform(*laying.buried, number),
                ),
                laying,
            )
            first = end

    def local_places(self) -> tuple[Field, Field]:
        """Return the (N, N) x and y of texels in the stamp on top, -1 to 1; 0 on bare ground."""
        if not self.count:
            return np.zeros_like(self.height), np.zeros_like(self.height)
        size_px = len(self.height)
        centre, radius, heading = (each.astype(np.float32) for each in self.placements[:3])
        ids = np.maximum(self.ids, 0)
        axis = np.arange(size_px, dtype=np.float32) + np.float32(0.5)
        half = np.float32(size_px / 2)
        down = (axis[:, None] - centre[:, 0][ids] + half) % size_px - half
        right = (axis[None, :] - centre[:, 1][ids] + half) % size_px - half
        scale = np.where(self.ids >= 0, 1 / radius[ids], 0)
        cos, sin = np.cos(heading)[ids] * scale, np.sin(heading)[ids] * scale
        return cos * right - sin * down, -sin * right - cos * down

    def _places(
        self,
        radii: FloatArray,
        laying: Laying,
        rng: np.random.Generator,
        density: Field | None,
    ) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return (P, 2) centres, and which of the things they are of."""
        size_px = len(self.height)
        centres = np.empty((len(radii), 2))
        waiting = np.arange(len(radii))
        for _ in range(TRIES):
            tried = rng.uniform(0, size_px, (len(waiting), 2))
            fits = np.ones(len(waiting), np.bool_)
            if density is not None:
                row, column = tried.astype(np.intp).T
                fits &= rng.uniform(size=len(waiting)) < density[row, column]
            if laying.makes_room:
                probes = tried[:, None] + PROBES * (PROBED * radii[waiting, None, None])
                row, column = np.moveaxis(probes.astype(np.intp) % size_px, -1, 0)
                fits &= (self.ids[row, column] >= 0).sum(axis=1) <= MOST_COVERED
            centres[waiting[fits]] = tried[fits]
            waiting = waiting[~fits]
        found = np.setdiff1d(np.arange(len(radii)), waiting)
        return centres[found], found

    def _lay(self, stamps: MeshStamps, placed: Placements, laying: Laying) -> None:
        first = self.count
        self.classes.append(placed)
        numbers = np.arange(len(placed.centre))
        is_large = placed.radius_px >= LARGE_PX
        for number in numbers[is_large]:
            self._lay_one(stamps, placed.at(slice(number, number + 1)), laying, first + number)
        small = numbers[~is_large]
        if not len(small):
            return
        half = int(np.ceil(placed.radius_px[small].max())) + 1
        parts = np.array_split(small, 1 + len(small) * (2 * half + 1) ** 2 // CHUNK_PX)
        for part in parts:
            self._lay_many(stamps, placed.at(part), laying, first + part, half)

    def _lay_one(self, stamps: MeshStamps, placed: Placements, laying: Laying, number: int) -> None:
        (row, column), radius = placed.centre[0], float(placed.radius_px[0])
        image = stamps.level_for(radius)[placed.shape[0]]
        half = int(np.ceil(radius)) + 1
        window = self._window(int(row), int(column), half)
        dome = turn_stamp(image, placed, half)
        dome[dome > 0] *= laying.flatness
        inside = dome > INSIDE
        if not inside.any():
            return
        ground = self.height[window]
        top = float(stamps.top[placed.shape[0]]) * laying.flatness
        below = ground[inside]
        mean, highest = float(np.float32(below.mean(dtype=np.float64))), float(below.max())
        unit = radius / len(self.height)
        base = mean + laying.rest * (highest - mean) - float(placed.buried[0]) * top * unit
        z = np.float32(base) + dome * np.float32(unit)
        if laying.follows:
            z += laying.follows * leaning(ground, inside)
        seen = inside & (z > ground)
        self.height[window] = np.where(seen, z, ground)
        self.ids[window] = np.where(seen, number, self.ids[window])
        self.above[window] = np.where(
            seen, above_ground(z, mean, base, top * unit), self.above[window]
        )

    def _window(
        self, row: int, column: int, half: int
    ) -> tuple[slice, slice] | tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the index of a square around a texel, across the tile's edges too."""
        size_px = len(self.height)
        if min(row, column) >= half and max(row, column) < size_px - half:
            return slice(row - half, row + half + 1), slice(column - half, column + half + 1)
        offset = np.arange(-half, half + 1)
        rows, columns = (row + offset) % size_px, (column + offset) % size_px
        return rows[:, None], columns[None, :]

    def _lay_many(
        self,
        stamps: MeshStamps,
        placed: Placements,
        laying: Laying,
        numbers: NDArray[np.intp],
        half: int,
    ) -> None:
        size_px = len(self.height)
        images = stamps.level_for(half)
        corner = np.floor(placed.centre).astype(np.int64)
        offset = np.arange(-half, half + 1)
        scale = placed.radius_px[:, None]
        down, right = (
            ((corner[:, k : k + 1] + offset + 0.5 - placed.centre[:, k : k + 1]) / scale).astype(
                np.float32
            )
            for k in (0, 1)
        )
        down, right = down[:, :, None], right[:, None, :]
        cos, sin = (f(placed.heading).astype(np.float32)[:, None, None] for f in (np.cos, np.sin))
        edge = images.shape[1]
        x = np.floor((cos * right - sin * down + 1) * np.float32(edge / 2)).astype(np.int32)
        y = np.floor((sin * right + cos * down + 1) * np.float32(edge / 2)).astype(np.int32)
        is_in = (x >= 0) & (x < edge) & (y >= 0) & (y < edge)
        flat = (placed.shape[:, None, None] * edge + y.clip(0, edge - 1)) * edge
        dome = np.where(is_in, images.ravel()[flat + x.clip(0, edge - 1)], OUTSIDE)
        inside = dome > INSIDE
        rows = (corner[:, :1] + offset) % size_px
        columns = (corner[:, 1:] + offset) % size_px
        texels = rows[:, :, None] * size_px + columns[:, None, :]
        ground = self.height.ravel()[texels]
        mean = (ground * inside).sum((1, 2), dtype=np.float64) / np.maximum(inside.sum((1, 2)), 1)
        # The order of sums is up to NumPy.
        mean = mean.astype(np.float32).astype(np.float64)
        unit = (placed.radius_px / size_px).astype(np.float32)
        rise = laying.flatness * unit
        top = stamps.top[placed.shape] * rise
        base = mean - placed.buried * top
        z = (base[:, None, None] + dome * rise[:, None, None]).astype(np.float32)
        thing, v, u = np.nonzero(inside & (z > ground))
        # Written from low to high, so that the highest of the chunk remains.
        order = np.argsort(z[thing, v, u], kind="stable")
        thing, v, u = thing[order], v[order], u[order]
        target = texels[thing, v, u]
        self.height.ravel()[target] = z[thing, v, u]
        self.ids.ravel()[target] = numbers[thing]
        self.above.ravel()[target] = above_ground(
            z[thing, v, u], mean[thing], base[thing], top[thing]
        )
