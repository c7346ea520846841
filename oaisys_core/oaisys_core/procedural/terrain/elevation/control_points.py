"""Rasters that say by ground control points (GCPs) alone where their pixels are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray

if TYPE_CHECKING:
    from affine import Affine

LEAST = 3
"""Control points of which a raster needs at least so many, not in a line."""

STRAIGHT_PX = 0.25
"""Largest distance of a control point from where an affine map has it, at which that is used."""


def affine_of(points: Sequence[Any], name: str, field: str) -> Affine:
    """Return the affine map from column and row to x and y that fits control points best.

    Args:
        points: Of rasterio: ``col``, ``row``, ``x``, ``y``.
        name: Of the file in errors.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: They are too few, or in a line.
    """
    from affine import Affine

    pixels, places = _arrays(points)
    middle_px, middle = pixels.mean(axis=0), places.mean(axis=0)
    # Without their middle: coordinates of a map have seven digits before the point.
    fit, _, rank, _ = np.linalg.lstsq(pixels - middle_px, places - middle, rcond=1e-9)
    if len(points) < LEAST or rank < 2 or not np.isfinite(fit).all():
        found = f"{name}: {len(points)} control points"
        raise InvalidInputError(f"{field}.file", found, f"at least {LEAST}, not in a line")
    (a, d), (b, e) = fit
    c, f = middle - middle_px @ fit
    return Affine(a, b, c, d, e, f)


def residual_px(points: Sequence[Any], transform: Affine) -> float:
    """Return the largest distance, in pixels, of control points from where a map has them."""
    pixels, places = _arrays(points)
    inverse = ~transform
    found = np.array([inverse @ tuple(place) for place in places.tolist()])
    return float(np.hypot(*(found - pixels).T).max())


def straighten(
    values: FloatArray, points: Sequence[Any], transform: Affine, system: Any
) -> FloatArray:
    """Return values resampled to a straight grid of the same size.

    GDAL's polynomials go through the control points: of the first order for three to five of them,
    of the second for up to nine, of the third for more.

    Args:
        values: (rows, cols), NaN where there are none; they stay so.
        points: The control points.
        transform: Of the straight grid, from column and row to x and y.
        system: Reference system of x and y, as rasterio has it.

    Returns:
        (rows, cols); NaN also where the grid lies beyond the file.
    """
    from rasterio.warp import Resampling, reproject

    result = np.full_like(values, np.nan)
    reproject(
        np.ascontiguousarray(values),
        result,
        gcps=list(points),
        src_crs=system,
        src_nodata=np.nan,
        dst_transform=transform,
        dst_crs=system,
        dst_nodata=np.nan,
        resampling=Resampling.cubic,
        tolerance=0.0,
    )
    return result


def _arrays(points: Sequence[Any]) -> tuple[FloatArray, FloatArray]:
    """Return (N, 2) columns and rows, and (N, 2) x and y."""
    pixels = np.array([(point.col, point.row) for point in points], np.float64).reshape(-1, 2)
    places = np.array([(point.x, point.y) for point in points], np.float64).reshape(-1, 2)
    return pixels, places
