"""Outlines of masks as polygons, along the edges of pixels.

A polygon's points are corners of pixels, counted from the image's corner: the first pixel is the
square from (0, 0) to (1, 1). Who fills it by the even-odd rule gets the mask back, pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Ring = NDArray[np.int64]
"""(V, 2) corners (x, y) of a closed polygon; the first is not repeated."""

_Corner = tuple[int, int]

RIGHT, DOWN, LEFT, UP = (1, 0), (0, 1), (-1, 0), (0, -1)
"""Directions along the edges of pixels; each is followed by the one that turns right."""

DIRECTIONS = (RIGHT, DOWN, LEFT, UP)


def mask_outlines(mask: NDArray[Any]) -> list[Ring]:
    """Return a polygon for each part of an (H, W) mask whose pixels share edges.

    A hole is joined to its part's outline by a line there and back, which encloses nothing.
    """
    from scipy import ndimage

    rows, columns = np.nonzero(mask)
    if not len(rows):
        return []
    top, left = int(rows.min()), int(columns.min())
    cropped = np.pad(mask[top : rows.max() + 1, left : columns.max() + 1].astype(bool), 1)
    parts, count = ndimage.label(cropped)
    outer: dict[int, Ring] = {}
    holes: dict[int, list[Ring]] = {}
    for ring, part in _rings(cropped, parts):
        if _area(ring) > 0:
            outer[part] = ring
        else:
            holes.setdefault(part, []).append(ring)
    shift = np.array((left - 1, top - 1))
    return [join_rings([outer[n], *holes.get(n, [])]) + shift for n in range(1, count + 1)]


def join_rings(rings: Sequence[Ring]) -> Ring:
    """Return one polygon of several, each joined to those before it by the shortest line."""
    joined, *others = rings
    for ring in others:
        apart = np.abs(joined[:, None] - ring[None]).sum(axis=2)
        here, there = np.unravel_index(int(apart.argmin()), apart.shape)
        turned = np.roll(ring, -int(there), axis=0)
        joined = np.concatenate((joined[: here + 1], turned, turned[:1], joined[here:]))
    return joined


def _rings(mask: NDArray[np.bool_], parts: NDArray[Any]) -> list[tuple[Ring, int]]:
    """Return the closed outlines of a mask with a margin, and the part that each belongs to.

    The mask is to the right of each step, so that outer outlines and holes turn in different ways.
    """
    ways = _steps(mask, parts)
    found = []
    while ways:
        start = corner = next(iter(ways))
        step: _Corner | None = next(iter(ways[start]))
        part, corners = 0, []
        # Each step that is taken is removed, so an outline ends where no step is left.
        while step is not None:
            corners.append(corner)
            part = ways[corner].pop(step)
            if not ways[corner]:
                del ways[corner]
            corner = corner[0] + step[0], corner[1] + step[1]
            step = None if corner == start else _next(ways.get(corner, {}), step)
        found.append((_without_straight(corners), part))
    return found


def _next(ways: dict[_Corner, int], step: _Corner) -> _Corner | None:
    """Return the step after another: right if there is one, so that parts stay apart."""
    at = DIRECTIONS.index(step)
    for turn in (1, 0, 3):
        following = DIRECTIONS[(at + turn) % 4]
        if following in ways:
            return following
    return None


def _steps(mask: NDArray[np.bool_], parts: NDArray[Any]) -> dict[_Corner, dict[_Corner, int]]:
    """Return the steps along edges by the corner where they begin, with a pixel's part for each."""
    ways: dict[_Corner, dict[_Corner, int]] = {}
    for step, (dy, dx), (x0, y0) in (
        (RIGHT, (-1, 0), (0, 0)),
        (DOWN, (0, 1), (1, 0)),
        (LEFT, (1, 0), (1, 1)),
        (UP, (0, -1), (0, 1)),
    ):
        beside = np.roll(mask, (-dy, -dx), axis=(0, 1))
        rows, columns = np.nonzero(mask & ~beside)
        numbers = parts[rows, columns].tolist()
        places = zip((columns + x0).tolist(), (rows + y0).tolist(), numbers, strict=True)
        for x, y, number in places:
            ways.setdefault((x, y), {})[step] = number
    return ways


def _without_straight(corners: Sequence[_Corner]) -> Ring:
    """Return the corners at which an outline turns."""
    ring = np.array(corners, np.int64)
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turns = before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]
    return np.asarray(ring[turns])


def _area(ring: Ring) -> float:
    """Return the area that a ring encloses; negative if it turns left, as holes do."""
    x, y = ring.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()) / 2
