"""Fallen leaves, cast from above: flat blades that have dried, curled and buckled."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from oaisys_core import randomness
from oaisys_core.procedural.textures.baking.stamps import MeshStamps, cast_stamps
from oaisys_core.types import FloatArray, TriangleMesh

SHAPES = 18
ALONG, ACROSS = 48, 12
"""Quads of a blade along its midrib and across."""

STALK = 0.14
"""Share of the length that is stalk."""

WIDTH = (0.38, 0.62)
"""Largest width of a blade in units of its length, of entire leaves such as those of beeches."""

LOBES = 4
"""Pairs of lobes of every third leaf, as those of oaks."""


@cache
def cast_leaves() -> MeshStamps:
    """Cast `SHAPES` leaves, the same for all sets; x is along the midrib, from stalk to tip."""
    rng = randomness.stream(0, "stamps/leaf")
    return cast_stamps([leaf_mesh(rng, is_lobed=k % 3 == 2) for k in range(SHAPES)], 128)


def leaf_mesh(rng: np.random.Generator, is_lobed: bool) -> TriangleMesh:
    """Return a leaf of length 1 that lies on its lowest point, along x.

    Args:
        rng: Draws its outline, and how it has curled.
        is_lobed: Whether its margin is lobed.
    """
    along, across = np.meshgrid(
        np.linspace(0, 1, ALONG + 1), np.linspace(-1, 1, ACROSS + 1), indexing="ij"
    )
    half = _half_width(along, rng, is_lobed)
    y = across * half
    bend = rng.normal(0, 0.06)
    height = rng.normal(0.25, 0.35) * y**2 / 0.3  # rolled along the midrib
    height += rng.normal(0.05, 0.12) * (along - 0.5) ** 2  # bent from stalk to tip
    height += rng.normal(0, 0.10) * y * (along - 0.5)  # twisted
    waves = rng.uniform(2, 4) * 2 * np.pi * along + rng.uniform(0, 2 * np.pi)
    height += 0.012 * np.sin(waves) * across**2  # the margin buckles as it dries
    height -= 0.008 * np.exp(-((across / 0.12) ** 2)) - 0.008  # the rib is a groove
    points = np.stack((along, y + bend * np.sin(np.pi * along), height), axis=-1).reshape(-1, 3)
    return TriangleMesh(points, _quads())


def _half_width(along: FloatArray, rng: np.random.Generator, is_lobed: bool) -> FloatArray:
    """Return half of the width at shares of the length, the stalk's first."""
    blade = np.clip((along - STALK) / (1 - STALK), 0, 1)
    widest, pointed = rng.uniform(0.7, 1.1), rng.uniform(0.75, 1.0)
    outline = np.sin(np.pi * blade**widest) ** pointed
    half = rng.uniform(*WIDTH) / 2 * outline
    if is_lobed:
        lobes = 0.5 - 0.5 * np.cos(2 * np.pi * LOBES * blade)
        half = half * (0.55 + 0.55 * lobes * np.clip(4 * (1 - blade), 0, 1))
    return np.asarray(np.maximum(half, 0.008 * (along < 0.97)))


@cache
def _quads() -> NDArray[np.int32]:
    row, column = np.meshgrid(np.arange(ALONG), np.arange(ACROSS), indexing="ij")
    first = (row * (ACROSS + 1) + column).ravel()
    a, b, c, d = first, first + ACROSS + 1, first + ACROSS + 2, first + 1
    corners = np.concatenate((np.stack((a, b, c), 1), np.stack((a, c, d), 1)))
    return np.asarray(corners, np.int32)
