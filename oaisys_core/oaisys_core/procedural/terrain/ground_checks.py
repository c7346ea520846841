"""What every ground is held to: heights and edges within bounds, surface to stand on.

Whatever reads or makes a ground uses these checks, so that a stored stage is no other than a new
one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.stage import LEAST_EXTENT_M, MAX_PX
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import MAX_M
from oaisys_core.procedural.meshes.checks import BLOCK, MAX_STEP_M, check_mesh
from oaisys_core.procedural.terrain.mesh_ground import MeshGround
from oaisys_core.scene import Ground, HeightField

FARTHEST_M = 2 * MAX_M
"""Largest coordinate of a grid: its middle is within `MAX_M`, and its edges are no longer."""

LEAST_SHARE = 1e-6
"""Least share of its extent that a mesh covers, seen from above; walls alone cover nothing."""

LEAST_STEPS = 10
"""Size of a triangle, in steps of float32 where it lies, below which it loses its form."""

MAX_BLURRED = 1e-3
"""Share of such triangles, beyond which a ground is refused."""

HEIGHTS_EXPECTED = f"finite heights of at most {MAX_M:g} m"


def are_heights(elevation_m: NDArray[Any]) -> bool:
    """Return whether all elevations of a ground are finite and within `MAX_M`."""
    lowest_m, highest_m = elevation_m.min(), elevation_m.max()
    return bool(lowest_m >= -MAX_M and highest_m <= MAX_M)  # not so of NaN


def check_grid(ground: HeightField, path: Path, field: str) -> None:
    """Raise if a grid from a file cannot be the ground of a stage.

    Args:
        ground: The grid.
        path: The file.
        field: Name of the file's field in errors.

    Raises:
        InvalidInputError: Its heights have another type or shape or are out of bounds, or its
            spacing or place is none of a stage.
    """
    heights = ground.elevation_m
    expected = ""
    if not _has_form(heights, np.float32, (None, None)):
        expected = f"float32 heights in rows and columns, not {heights.dtype} {heights.shape}"
    elif min(heights.shape) < 2 or max(heights.shape) > MAX_PX:
        expected = f"2 to {MAX_PX} points along an edge, not {heights.shape}"
    elif not are_heights(heights):
        expected = HEIGHTS_EXPECTED
    elif not 0 < ground.spacing_m < np.inf:
        expected = f"a spacing above 0 m, not {ground.spacing_m:g} m"
    elif not all(abs(edge_m) <= FARTHEST_M for edge_m in ground.extent_m):  # not NaN either
        place = ", ".join(f"{value:g}" for value in ground.origin_xy_m)
        expected = f"a ground within {FARTHEST_M:g} m, not one from ({place}) m on"
    if expected:
        raise InvalidInputError(field, str(path), expected)
    check_extent(ground, path, field)


def check_triangles(ground: MeshGround, path: Path, field: str) -> None:
    """Raise if triangles from a file cannot be the ground of a stage.

    Raises:
        InvalidInputError: Vertices or indices have another type or shape; see also `check_mesh`
            and `check_surface`.
    """
    points, corners = ground.points_m, ground.corners
    expected = ""
    if not _has_form(points, np.float32, (None, 3)):
        expected = f"float32 vertices of three coordinates, not {points.dtype} {points.shape}"
    elif not _has_form(corners, np.int32, (None, 3)):
        expected = f"int32 triangles of three indices, not {corners.dtype} {corners.shape}"
    elif not (len(points) and len(corners)):
        expected = "at least one triangle"
    if expected:
        raise InvalidInputError(field, str(path), expected)
    check_mesh(points, corners, path, field)
    check_surface(ground, path, field)


def check_surface(ground: MeshGround, path: Path, field: str) -> None:
    """Raise if a mesh is no ground to stand on.

    Args:
        ground: The ground.
        path: The file.
        field: Name of the file's field in errors.

    Raises:
        InvalidInputError: Its extent is no stage's; or its triangles are vertical, lie far apart,
            or are too small for float32 at that extent.
    """
    check_extent(ground, path, field)
    _check_cover(ground, path, field)
    _check_resolution(ground, path, field)


def check_extent(ground: Ground, path: Path, field: str) -> None:
    """Raise if a ground from a file has an edge that no stage can have.

    The relief of one far smaller than `LEAST_EXTENT_M` takes minutes to compute.

    Args:
        ground: The ground.
        path: The file.
        field: Name of the file's field in errors.

    Raises:
        InvalidInputError: It is too short or too long in x or in y.
    """
    x0, y0, x1, y1 = ground.extent_m
    # A tenth of a percent of the bound may be lost where coordinates are float32.
    low_m, high_m = 0.999 * LEAST_EXTENT_M, 1.001 * MAX_M
    if not all(low_m <= edge_m <= high_m for edge_m in (x1 - x0, y1 - y0)):
        expected = (
            f"a ground of {LEAST_EXTENT_M:g} to {MAX_M:g} m in x and in y,"
            f" not {x1 - x0:.6g} x {y1 - y0:.6g} m"
        )
        raise InvalidInputError(field, str(path), expected)


def _check_cover(ground: MeshGround, path: Path, field: str) -> None:
    """Raise if a mesh has hardly any surface seen from above, such as a vertical wall."""
    x0, y0, x1, y1 = ground.extent_m
    covered_m2 = len(ground.corners) * ground.spacing_m**2 / 2
    if not covered_m2 >= LEAST_SHARE * (x1 - x0) * (y1 - y0):
        expected = (
            f"triangles that cover {LEAST_SHARE:g} of its extent of {x1 - x0:.6g} x {y1 - y0:.6g} m"
            f" seen from above, not {covered_m2:.3g} m2: vertical ones have no ground, and between"
            " parts that lie far apart there is none"
        )
        raise InvalidInputError(field, str(path), expected)


def _check_resolution(ground: MeshGround, path: Path, field: str) -> None:
    """Raise if float32 does not resolve a mesh's triangles where they lie."""
    if np.spacing(np.abs(ground.points_m).max()) <= MAX_STEP_M:
        return
    blurred, coarsest_m = 0, 0.0
    for first in range(0, len(ground.corners), BLOCK):
        points_m = ground.points_m[ground.corners[first : first + BLOCK]]
        steps_m = np.spacing(np.abs(points_m).max(axis=(1, 2)))
        is_blurred = np.ptp(points_m, axis=1).max(axis=1) < LEAST_STEPS * steps_m
        is_blurred &= steps_m > MAX_STEP_M
        blurred += int(np.count_nonzero(is_blurred))
        coarsest_m = max(coarsest_m, float(steps_m[is_blurred].max(initial=0.0)))
    if blurred > MAX_BLURRED * len(ground.corners):
        x0, y0, x1, y1 = ground.extent_m
        expected = (
            f"triangles of at least {LEAST_STEPS} steps of a 32-bit float, but over an extent of"
            f" {x1 - x0:.6g} x {y1 - y0:.6g} m these reach {coarsest_m:.3g} m, and {blurred} of"
            f" {len(ground.corners)} triangles are smaller: leave out what lies far away"
        )
        raise InvalidInputError(field, str(path), expected)


def _has_form(array: NDArray[Any], dtype: type, shape: tuple[int | None, ...]) -> bool:
    return (
        array.dtype == dtype
        and array.ndim == len(shape)
        and all(length in (None, found) for length, found in zip(shape, array.shape, strict=True))
    )
