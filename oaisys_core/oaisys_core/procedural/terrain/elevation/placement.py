"""From the pixels of an elevation model to a grid in true distances."""

from __future__ import annotations

import logging
from math import ceil, cos, isfinite, radians
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oaisys_core.config.sections.stage import MAX_PX, DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.elevation.references import (
    LocalScale,
    Reference,
    georeference_of_pixels,
    measure_scale,
)
from oaisys_core.procedural.terrain.elevation.warp import LocalGrid, indices, spline_through
from oaisys_core.types import FloatArray, Georeference

if TYPE_CHECKING:
    from affine import Affine

LOG = logging.getLogger(__name__)

MAX_VARIATION = 1e-3
"""Difference of a pixel's true size across the stage from which it is warped."""

MAX_DEGREES_PER_PX = 0.05
"""Pixels in degrees are smaller than this in files with relief."""

TURNED_DEG = 1.0
"""Angle between +y and true north from which the log has a warning."""


class PlacedHeights(NamedTuple):
    """Heights on a square grid around the origin of ``map``.

    Attributes:
        height_m: (rows, cols), row 0 in the south.
        step_m: Distance between its points.
        georeference: Where it lies on its body, with heights as they are; None if it is nowhere.
    """

    height_m: FloatArray
    step_m: float
    georeference: Georeference | None


def place_on_ground(
    height_m: FloatArray,
    transform: Affine | None,
    reference: Reference | None,
    config: DemConfig,
    field: str,
) -> PlacedHeights:
    """Return heights on a square grid around the origin, row 0 in the south.

    Args:
        height_m: (rows, cols) heights, as in the file.
        transform: From column and row to x and y; None if the file has no places.
        reference: Of x and y.
        config: Sizes that override those of the file.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: The pixels' size is unknown, or they cannot be a ground.
    """
    stated_m = _stated_pixel_m(height_m.shape, config)
    of_body = None if reference is None or reference.is_local else reference
    if transform is not None:
        on_body = of_body if stated_m is None else None
        _check_transform(transform, field, may_turn=on_body is not None)
        if on_body is not None:
            return _place_on_body(height_m, transform, on_body, config, field)
    turned = reference is not None and reference.is_turned
    flip_rows = transform is not None and (transform.e > 0) != turned
    flip_cols = transform is not None and (transform.a < 0) != turned
    pixel_m = stated_m or _own_pixel_m(transform, reference, config, field)
    turned_m = _turn(height_m, flip_rows, flip_cols)
    return PlacedHeights(*_resample_to_step(turned_m, pixel_m, config, field), None)


def _stated_pixel_m(shape: tuple[int, ...], config: DemConfig) -> tuple[float, float] | None:
    if config.size_m is not None:
        return (config.size_m[0] / (shape[1] - 1), config.size_m[1] / (shape[0] - 1))
    return None if config.spacing_m is None else (config.spacing_m, config.spacing_m)


def _own_pixel_m(
    transform: Affine | None, reference: Reference | None, config: DemConfig, field: str
) -> tuple[float, float]:
    """Return the pixel's size of a file that is of no place on a body."""
    if transform is None:
        expected = f"the distance between pixels, because {config.file.name} does not define it"
        raise InvalidInputError(f"{field}.spacing_m", None, expected)
    sizes = (abs(transform.a), abs(transform.e))
    if reference is not None:
        return (sizes[0] * reference.unit_m, sizes[1] * reference.unit_m)
    in_degrees = abs(transform.c) <= 360 and abs(transform.f) <= 90.5
    if in_degrees and max(sizes) < MAX_DEGREES_PER_PX:
        expected = (
            f"a reference system, because the coordinates of {config.file.name} look like degrees,"
            f" such as EPSG:4326; if they are metres, {field}.spacing_m: {sizes[0]:.9g}"
        )
        raise InvalidInputError(f"{field}.crs", None, expected)
    return sizes


def _check_transform(transform: Affine, field: str, *, may_turn: bool) -> None:
    if not all(map(isfinite, transform)) or transform.determinant == 0:
        expected = "corner and pixels' size in finite numbers, the size not 0"
        raise InvalidInputError(f"{field}.file", tuple(transform)[:6], expected)
    size = abs(transform.a) + abs(transform.e)
    if not may_turn and abs(transform.b) + abs(transform.d) > 1e-9 * size:
        expected = (
            "rows from west to east, or turned ones with a reference system of a body and without"
            f" {field}.spacing_m and size_m (gdalwarp turns a file)"
        )
        raise InvalidInputError(f"{field}.file", tuple(transform)[:6], expected)


def _turn(height_m: FloatArray, flip_rows: bool, flip_cols: bool) -> FloatArray:
    height_m = height_m[:, ::-1] if flip_cols else height_m
    return height_m if flip_rows else height_m[::-1]


def _place_on_body(
    height_m: FloatArray, transform: Affine, reference: Reference, config: DemConfig, field: str
) -> PlacedHeights:
    scale = measure_scale(reference, transform, height_m.shape, field)
    flip_rows = (transform.e > 0) != reference.is_turned
    up_deg = (scale.up_deg + (180 if flip_rows else 0) + 180) % 360 - 180
    _tell(reference, scale, up_deg, config)
    if scale.variation <= MAX_VARIATION:
        flip_cols = cos(radians(scale.right_deg - up_deg - 90)) < 0
        turned = _turn(height_m, flip_rows, flip_cols)
        signs = (-1 if flip_cols else 1, 1 if flip_rows else -1)
        steps = (signs[0] / scale.pixel_m[0], signs[1] / scale.pixel_m[1])
        place = georeference_of_pixels(reference, transform, height_m.shape, steps)
        return PlacedHeights(*_resample_to_step(turned, scale.pixel_m, config, field), place)
    grid = LocalGrid(reference, transform, height_m.shape, up_deg, field)
    step_m = config.ground_spacing_m or min(scale.pixel_m)
    counts = _grid_points(grid.half_m, step_m, field)
    LOG.warning(
        "%s: pixels differ by %.2f %% across the file, so it is warped to true distances from its"
        " middle; the ground is %.7g x %.7g m, the largest rectangle inside of the file",
        config.file,
        100 * scale.variation,
        *(2 * half for half in grid.half_m),
    )
    return PlacedHeights(grid.warp(height_m, step_m, counts), step_m, grid.georeference)


def _tell(reference: Reference, scale: LocalScale, up_deg: float, config: DemConfig) -> None:
    LOG.info(
        "%s: pixels are %.7g x %.7g m (%s, coordinates in %s); %s",
        config.file,
        *scale.pixel_m,
        reference.horizontal.name,
        reference.unit_name,
        reference.height_name,
    )
    if abs(up_deg) > TURNED_DEG:
        LOG.warning(
            "%s: +y, the file's north, points to %.2f° from true north", config.file, up_deg
        )


def _grid_points(half_m: tuple[float, float], step_m: float, field: str) -> tuple[int, int]:
    """Return the columns and rows of points in a rectangle, one of them in its middle."""
    counts = [2 * int(half / step_m * (1 + 1e-6)) + 1 for half in half_m]
    _check_counts(counts, step_m, field)
    return counts[0], counts[1]


def _check_counts(counts: list[int], step_m: float, field: str) -> None:
    if max(counts) > MAX_PX:
        expected = f"at most {MAX_PX} points along an edge (raise ground_spacing_m)"
        raise InvalidInputError(f"{field}.ground_spacing_m", step_m, expected)
    if min(counts) < 2:
        raise InvalidInputError(f"{field}.ground_spacing_m", step_m, "less than the file's extent")


def _resample_to_step(
    height_m: FloatArray, pixel_m: tuple[float, float], config: DemConfig, field: str
) -> tuple[FloatArray, float]:
    step_m = min(pixel_m) if config.ground_spacing_m is None else config.ground_spacing_m
    return _resample(height_m, pixel_m, step_m, field), step_m


def _resample(
    height_m: FloatArray, pixel_m: tuple[float, float], step_m: float, field: str
) -> FloatArray:
    """Return heights at points ``step_m`` apart, from pixels ``pixel_m`` apart."""
    import cv2

    rows, cols = height_m.shape
    # Tolerate one part in a million, more than the rounding in a GeoTIFF.
    counts = [
        int((n - 1) * m / step_m * (1 + 1e-6)) + 1
        for n, m in ((rows, pixel_m[1]), (cols, pixel_m[0]))
    ]
    _check_counts(counts, step_m, field)
    steps = (step_m / pixel_m[1], step_m / pixel_m[0])
    if max(abs(step - 1) for step in steps) < 1e-6:
        return height_m
    reduced = [max(1, ceil(step - 1e-6)) for step in steps]
    if max(reduced) > 1:
        # Smooth first, because finer relief would alias.
        kernel = tuple(2 * (n // 2) + 1 for n in reduced)
        height_m = cv2.blur(height_m, kernel[::-1], borderType=cv2.BORDER_REFLECT_101)
    axes = [
        (np.arange(n) - (n - 1) / 2) * step + (size - 1) / 2
        for n, step, size in zip(counts, steps, height_m.shape, strict=True)
    ]
    return np.asarray(spline_through(indices(height_m.shape), height_m)(*axes))
