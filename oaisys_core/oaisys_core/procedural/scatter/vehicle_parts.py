"""Details that vehicles are made of: cases, access panels, foil and stripes."""

from __future__ import annotations

import numpy as np

from oaisys_core.procedural.scatter.mesh_builder import MeshBuilder
from oaisys_core.types import FloatArray

Color = tuple[float, float, float]

BEVEL, MAX_BEVEL_M = 0.12, 0.02
"""Bevel of a case as a share of its thinnest side, and at most."""

BOLT_M, BOLT_COLOR = 0.007, (0.22, 0.22, 0.23)
"""Radius of a bolt's head."""

FOIL_CELLS, FOIL_DEPTH_M, FOIL_SHADES = (5, 4), 0.014, (0.78, 1.12)
"""Creases across and up a sheet of foil, their depth, and the range of their brightness."""


def case(
    parts: MeshBuilder,
    centre_m: FloatArray | tuple[float, float, float],
    size_m: tuple[float, float, float],
    color: Color,
    R: FloatArray | None = None,
) -> None:
    """Add a box with bevelled edges."""
    parts.box(centre_m, size_m, color, R, min(BEVEL * min(size_m), MAX_BEVEL_M))


def access_panel(
    parts: MeshBuilder,
    centre_m: FloatArray | tuple[float, float, float],
    size_m: tuple[float, float],
    color: Color,
    R: FloatArray,
) -> None:
    """Add a thin plate with a bolt in each corner, on a surface.

    Args:
        centre_m: On the surface.
        size_m: Along the plate's x and y axes.
        R: The plate's axes as columns; z points away from the surface.
    """
    centre = np.asarray(centre_m, np.float64)
    width_m, height_m = size_m
    parts.box(centre + 0.003 * R[:, 2], (width_m, height_m, 0.006), color, R, 0.002)
    for x in (-1, 1):
        for y in (-1, 1):
            bolt = centre + R @ (x * (width_m / 2 - 0.02), y * (height_m / 2 - 0.02), 0.005)
            parts.rod(bolt, bolt + 0.004 * R[:, 2], BOLT_M, BOLT_COLOR, 6)


def stripes(
    parts: MeshBuilder,
    centre_m: FloatArray | tuple[float, float, float],
    size_m: tuple[float, float],
    colors: tuple[Color, ...],
    R: FloatArray,
) -> None:
    """Add a mark of stripes beside each other along the plate's x axis; see `access_panel`."""
    width_m = size_m[0] / len(colors)
    for index, color in enumerate(colors):
        offset = R @ ((index - (len(colors) - 1) / 2) * width_m, 0.0, 0.001)
        parts.box(np.asarray(centre_m) + offset, (width_m, size_m[1], 0.002), color, R)


def foil(parts: MeshBuilder, corners_m: FloatArray, color: Color, rng: np.random.Generator) -> None:
    """Add a creased sheet between (4, 3) corners, counter-clockwise from outside."""
    across, up = FOIL_CELLS
    s, t = np.meshgrid(np.linspace(0, 1, across + 1), np.linspace(0, 1, up + 1))
    a, b, c, d = corners_m
    s, t = s[..., None], t[..., None]
    points = (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * d + s * c)
    outward = np.cross(b - a, d - a)
    outward /= np.linalg.norm(outward)
    # Edges stay where they are, so that neighbouring sheets meet.
    depth_m = np.zeros(points.shape[:2])
    depth_m[1:-1, 1:-1] = rng.uniform(-1, 1, (up - 1, across - 1)) * FOIL_DEPTH_M
    points = points + depth_m[..., None] * outward
    for row in range(up):
        for column in range(across):
            quad = points[[row, row, row + 1, row + 1], [column, column + 1, column + 1, column]]
            first = rng.integers(2)
            for triangle in ((0, 1, 2), (0, 2, 3)) if first else ((0, 1, 3), (1, 2, 3)):
                shade = rng.uniform(*FOIL_SHADES)
                parts.add(quad[list(triangle)], [(0, 1, 2)], np.clip(np.array(color) * shade, 0, 1))


def facing(axis: str) -> FloatArray:
    """Return the axes of a plate whose z axis is one of ``+x``, ``-x``, ``+y``, ``-y``, ``+z``.

    Its y axis points up, or forward if it lies flat.
    """
    if axis == "+z":
        return np.eye(3)
    out = np.zeros(3)
    out["xy".index(axis[1])] = 1.0 if axis[0] == "+" else -1.0
    up = np.array((0.0, 0.0, 1.0))
    return np.column_stack((np.cross(up, out), up, out))
