"""Rectangular rings of points around a stage, and the triangles between them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.surroundings.border import Border
from oaisys_core.types import FloatArray

SPACING_SHARE = 0.025
"""Spacing of points along a ring, as a share of the distance from the stage's edge: half a degree
to 2 degrees for a camera on the stage."""

STRETCH = 2.2
"""Distance between rings in units of the spacing along them: land is seen at a slant."""

NEAR_SHARE = 0.15
"""Added to the distance, in units of half the stage's shorter side."""


class Ring(NamedTuple):
    """A ring of points at a distance from a stage's edge.

    Attributes:
        offset_m: The distance.
        spacing_m: Spacing of its points.
        cells: Number of cells along a side in x, and along one in y.
        sides: (P,) side of each point: 0 for min_y, then counter-clockwise.
        along: (P,) place on the side, from 0 to 1.
    """

    offset_m: float
    spacing_m: float
    cells: tuple[int, int]
    sides: NDArray[np.int64]
    along: FloatArray

    @property
    def turns(self) -> FloatArray:
        """(P,) places on the ring in sides, from 0 to 4."""
        return self.sides + self.along

    def xy_m(self, border: Border) -> FloatArray:
        """Return (P, 2) positions; those of a ring without offset are the border's own points."""
        x0, y0, x1, y1 = border.extent_m
        d = self.offset_m
        x, y = (_axis(x0 - d, x1 + d, self.cells[0]), _axis(y0 - d, y1 + d, self.cells[1]))
        south, north = np.full(len(x), y0 - d), np.full(len(x), y1 + d)
        west, east = np.full(len(y), x0 - d), np.full(len(y), x1 + d)
        return np.concatenate(
            (
                np.column_stack((x, south))[:-1],
                np.column_stack((east, y))[:-1],
                np.column_stack((x, north))[:0:-1],
                np.column_stack((west, y))[:0:-1],
            )
        )

    def border_places(self, border: Border) -> FloatArray:
        """Return (P,) the corresponding places along the border, in its points."""
        lengths = np.array((*border.cells, *border.cells))
        starts = np.concatenate(([0], np.cumsum(lengths)[:-1]))
        return np.asarray(starts[self.sides] + self.along * lengths[self.sides])


def _axis(low_m: float, high_m: float, cells: int) -> FloatArray:
    return np.linspace(low_m, high_m, cells + 1)


def rings_around(border: Border, farthest_m: float) -> list[Ring]:
    """Return rings from a border outward, of decreasing resolution.

    From ring to ring, the spacing at most doubles. The first ring has the border's own points.
    """
    near_m = NEAR_SHARE * min(border.size_m) / 2
    own_m = max(size / cells for size, cells in zip(border.size_m, border.cells, strict=True))
    rings = [_ring(0.0, own_m, border.cells)]
    while rings[-1].offset_m < farthest_m:
        before = rings[-1]
        offset_m = before.offset_m + STRETCH * max(
            before.spacing_m, SPACING_SHARE * (before.offset_m + near_m) / 2
        )
        offset_m = min(offset_m, farthest_m)
        wanted_m = max(SPACING_SHARE * (offset_m + near_m), own_m)
        spacing_m = min(2 * before.spacing_m, wanted_m)
        cells = [max(1, round((size + 2 * offset_m) / spacing_m)) for size in border.size_m]
        rings.append(_ring(offset_m, spacing_m, (cells[0], cells[1])))
    return rings


def _ring(offset_m: float, spacing_m: float, cells: tuple[int, int]) -> Ring:
    counts = (*cells, *cells)
    sides = np.repeat(np.arange(4), counts)
    along = np.concatenate([np.arange(count) / count for count in counts])
    return Ring(offset_m, spacing_m, cells, sides, along)


def triangles_between(rings: list[Ring]) -> NDArray[np.int32]:
    """Return (T, 3) triangles, counter-clockwise from above, whose points count through all rings.

    There is no gap and no point on another triangle's edge, however many points two rings have.
    """
    starts = np.cumsum([0] + [len(ring.along) for ring in rings])
    strips = [
        _strip(inner.turns, outer.turns, int(first), int(second))
        for inner, outer, first, second in zip(rings, rings[1:], starts, starts[1:], strict=False)
    ]
    return np.concatenate(strips).astype(np.int32)


def _strip(
    inner: FloatArray, outer: FloatArray, first_inner: int, first_outer: int
) -> NDArray[np.int64]:
    """Return the triangles between two closed sequences of points, given by increasing places.

    Going round, the sequence whose next point comes first advances; each step is a triangle.
    """
    inner_ends, outer_ends = np.append(inner[1:], 4.0), np.append(outer[1:], 4.0)
    a, b = np.arange(len(inner)), np.arange(len(outer))
    a_next, b_next = (a + 1) % len(inner), (b + 1) % len(outer)
    across = np.searchsorted(outer_ends, inner_ends, side="left") % len(outer)
    back = np.searchsorted(inner_ends, outer_ends, side="right") % len(inner)
    return np.concatenate(
        (
            np.column_stack((first_inner + a_next, first_inner + a, first_outer + across)),
            np.column_stack((first_outer + b, first_outer + b_next, first_inner + back)),
        )
    )
