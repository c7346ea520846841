"""Dunes that the wind builds of slabs of sand, and the ripples on them.

After Werner, "Eolian dunes: computer simulations and attractor interpretation", Geology 23(12),
1995: slabs are picked up at random, carried along the wind, and laid down in the shadow of dunes at
once, else with a chance that is greater on sand than on bare ground; steep slopes slide.
"""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.terrain.processes.exact import tangent
from oaisys_core.procedural.terrain.processes.flow import Mask
from oaisys_core.types import FloatArray

SLAB = 0.2
"""Thickness of a slab in cells."""

SHADOW = tangent(15.0)
"""Slope down from a crest, below which there is no wind."""

ON_SAND, ON_GROUND = 0.6, 0.4
"""Chances that a slab stays where it lands."""

PICKED = 0.2
"""Share of the cells from which a slab is taken in a step."""

SLIDES = 2
"""Passes of slides in a step."""


def blow(
    sand: FloatArray,
    rng: np.random.Generator,
    *,
    steps: int,
    hop: int,
    repose: float,
    turn_cells: float = 0.0,
) -> FloatArray:
    """Return (rows, cols) thickness of sand in cells after wind along the columns; it keeps its
    mass.

    The field repeats beyond its edges.

    Args:
        sand: (rows, cols) thickness in cells.
        rng: Draws which slabs are carried.
        steps: Number of steps; in each, a fifth of the cells in the wind lose a slab.
        hop: Cells that a slab is carried at once.
        repose: Tangent of the angle of repose.
        turn_cells: Standard deviation of the shift across the wind in a hop.
    """
    h = sand.astype(np.float64)
    rows, cols = h.shape
    for _ in range(steps):
        shadow = in_shadow(h)
        taken = (rng.random(h.shape, np.float32) < PICKED) & ~shadow & (h >= SLAB)
        row, col = np.nonzero(taken)
        h[taken] -= SLAB
        while len(row):
            col = (col + hop) % cols
            if turn_cells:
                drift = np.rint(turn_cells * (2 * rng.random(len(row)) - 1)).astype(np.intp)
                row = (row + drift) % rows
            chance = np.where(h[row, col] > 0.5 * SLAB, ON_SAND, ON_GROUND)
            stays = shadow[row, col] | (rng.random(len(row)) < chance)
            landed = np.bincount(row[stays] * cols + col[stays], minlength=h.size)
            h += SLAB * landed.reshape(h.shape)
            row, col = row[~stays], col[~stays]
        h = _slide(h, repose)
    return h


def in_shadow(h: FloatArray) -> Mask:
    """Return (rows, cols) whether a crest upwind keeps the wind off a cell."""
    cols = h.shape[1]
    along = np.arange(2 * cols) * SHADOW
    # The highest line down from any crest upwind; twice around, because the field repeats.
    line = np.maximum.accumulate(np.concatenate((h, h), axis=1) + along, axis=1) - along
    before = line[:, cols - 1 : 2 * cols - 1] - SHADOW
    return np.asarray(h < before - 1e-9, np.bool_)


def _slide(h: FloatArray, repose: float) -> FloatArray:
    """Return the sand after slopes above the angle of repose have slid; the field repeats."""
    for _ in range(SLIDES):
        up = [0.5 * (np.roll(h, -1, axis) - np.roll(h, 1, axis)) for axis in (0, 1)]
        change = np.zeros_like(h)
        for axis in (0, 1):
            fall = np.roll(h, -1, axis) - h
            across = 0.5 * (up[1 - axis] + np.roll(up[1 - axis], -1, axis))
            steep = np.sqrt(fall * fall + across * across)
            over = np.maximum(steep - repose, 0.0) / np.maximum(steep, 1e-12)
            moved = 0.22 * fall * over
            # No more than half of a cell's sand goes each way.
            moved = np.clip(moved, -0.25 * h, 0.25 * np.roll(h, -1, axis))
            change += moved
            change -= np.roll(moved, 1, axis)
        h = h + change
    return h
