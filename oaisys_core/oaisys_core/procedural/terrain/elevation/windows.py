"""The part of a large elevation model that becomes a ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from oaisys_core.config.sections.stage import DemWindowConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry.places import waypoints_in_map
from oaisys_core.procedural.terrain.elevation.references import (
    Reference,
    georeference_of_pixels,
    measure_scale,
)

if TYPE_CHECKING:
    from affine import Affine

NEAR_PX = 64
"""Edge of the square by which the size of pixels in the window's middle is measured."""


class PixelWindow(NamedTuple):
    """Pixels of an image: the first column and row, and how many of each."""

    column: int
    row: int
    columns: int
    rows: int


def pixels_of(
    window: DemWindowConfig,
    reference: Reference,
    transform: Affine,
    shape: tuple[int, int],
    field: str,
) -> PixelWindow:
    """Return the pixels of a window.

    Args:
        window: Where it is.
        reference: Of the file's x and y, on a body.
        transform: From column and row to x and y.
        shape: Rows and columns of the file.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: It is not inside of the file.
    """
    rows, columns = shape
    middle = columns / 2, rows / 2
    if window.centre_lon_lat_deg is not None:
        # With a column and a row as "metres", these are offsets from the middle in pixels.
        pixels = georeference_of_pixels(reference, transform, shape, (1.0, 1.0))
        name = f"{field}.window.centre_lon_lat_deg"
        ((column, row, _),) = waypoints_in_map(pixels, [window.centre_lon_lat_deg], name).tolist()
        middle = middle[0] + column, middle[1] + row
    counts = _counts(window, reference, transform, middle, field)
    first = tuple(round(at - count / 2) for at, count in zip(middle, counts, strict=True))
    found = PixelWindow(first[0], first[1], counts[0], counts[1])
    ends = found.column + found.columns, found.row + found.rows
    if min(first) < 0 or ends[0] > columns or ends[1] > rows:
        received = f"columns {first[0]} to {ends[0]}, rows {first[1]} to {ends[1]}"
        expected = f"a window inside of the file, of {columns} columns and {rows} rows"
        raise InvalidInputError(f"{field}.window", received, expected)
    return found


def _counts(
    window: DemWindowConfig,
    reference: Reference,
    transform: Affine,
    middle: tuple[float, float],
    field: str,
) -> tuple[int, int]:
    """Return the columns and rows of a window around a pixel."""
    from affine import Affine

    near = transform @ Affine.translation(*(at - NEAR_PX / 2 for at in middle))
    scale = measure_scale(reference, near, (NEAR_PX, NEAR_PX), field)
    columns, rows = (
        max(2, round(size / pixel))
        for size, pixel in zip(window.size_m, scale.pixel_m, strict=True)
    )
    return columns, rows
