"""The bounds of a stage that a file gives: those of ``stage.extent_m``, and surface to stand on."""

from __future__ import annotations

from pathlib import Path

from oaisys_core.config.sections.stage import LEAST_EXTENT_M
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import MAX_M
from oaisys_core.procedural.terrain.mesh_ground import MeshGround
from oaisys_core.scene import Ground

LEAST_SHARE = 1e-6
"""Least share of its extent that a mesh covers, seen from above; walls alone cover nothing."""


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


def check_cover(ground: MeshGround, path: Path, field: str) -> None:
    """Raise if a mesh has hardly any surface seen from above, such as a vertical wall.

    Args:
        ground: The ground.
        path: The file.
        field: Name of the file's field in errors.

    Raises:
        InvalidInputError: Its triangles are vertical.
    """
    x0, y0, x1, y1 = ground.extent_m
    covered_m2 = len(ground.corners) * ground.spacing_m**2 / 2
    if not covered_m2 >= LEAST_SHARE * (x1 - x0) * (y1 - y0):
        expected = (
            f"triangles that cover {LEAST_SHARE:g} of its extent of {x1 - x0:.6g} x {y1 - y0:.6g} m"
            f" seen from above, not {covered_m2:.3g} m2: vertical ones have no ground"
        )
        raise InvalidInputError(field, str(path), expected)
