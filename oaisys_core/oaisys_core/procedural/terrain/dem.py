"""Digital elevation models from GeoTIFF, 16-bit PNG and EXR files."""

from __future__ import annotations

import logging
import re
import warnings
from dataclasses import dataclass, replace
from math import ceil, cos, pi, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.images import ELEVATION, ImageUse, open_geotiff, read_pixels
from oaisys_core.output import exr
from oaisys_core.procedural.terrain.holes import fill_holes, number_of_holes
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray

LOG = logging.getLogger(__name__)

TIFF_SUFFIXES = (".tif", ".tiff")
SUFFIXES = (*TIFF_SUFFIXES, ".png", ".exr")

MAX_PX = 8193
"""Largest number of points along an edge of a ground, as for presets."""

UNIT_M = {
    "": 1.0,
    "m": 1.0,
    "metre": 1.0,
    "meter": 1.0,
    "metres": 1.0,
    "meters": 1.0,
    "km": 1000.0,
    "cm": 0.01,
    "ft": 0.3048,
    "foot": 0.3048,
    "feet": 0.3048,
    "us survey foot": 1200 / 3937,
}
"""Metres per unit of height, by the names of units in GeoTIFF files."""


@dataclass(frozen=True)
class Dem:
    """The heights in a file.

    Attributes:
        height_m: (rows, cols) float64, row 0 in the south; NaN for missing values.
        pixel_m: Width (x) and height (y) of a pixel; None if the file does not define them.
    """

    height_m: FloatArray
    pixel_m: tuple[float, float] | None


@dataclass(frozen=True)
class ImportedGround:
    """A ground from a file, and how many missing heights were filled.

    Attributes:
        holes: Number of connected regions without heights, which were filled.
        filled_px: Number of pixels in these regions.
    """

    ground: HeightField
    holes: int
    filled_px: int


def import_dem(
    path: Path,
    *,
    spacing_m: float | None = None,
    scale: float = 1.0,
    offset_m: float | None = None,
    ground_spacing_m: float | None = None,
    band: int = 1,
    field: str = "stage.dem",
) -> ImportedGround:
    """Return the ground of a file, centred on the origin, with north along +y.

    Args:
        path: GeoTIFF, PNG or EXR.
        spacing_m: Distance between pixels; None uses that of the file.
        scale: Factor on the heights.
        offset_m: Offset added to the heights; None moves the median to 0.
        ground_spacing_m: Distance between grid points; None uses the smaller edge of a pixel.
        band: Band of a GeoTIFF.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: The file cannot be read or used, or does not define its pixel size.
    """
    dem = read_dem(path, band, field)
    pixel_m = dem.pixel_m if spacing_m is None else (spacing_m, spacing_m)
    if pixel_m is None:
        raise InvalidInputError(
            f"{field}.spacing_m",
            None,
            f"the distance between pixels, because {path.name} does not define it",
        )
    missing = ~np.isfinite(dem.height_m)
    if missing.all():
        raise InvalidInputError(f"{field}.file", str(path), "an image with heights in it")
    holes, filled_px = number_of_holes(missing), int(missing.sum())
    if holes:
        share = 100 * missing.mean()
        LOG.warning("%s: filled %d holes, %d pixels (%.2f %%)", path, holes, filled_px, share)
    height_m = fill_holes(dem.height_m, missing) * scale
    height_m += -float(np.median(height_m)) if offset_m is None else offset_m
    step_m = min(pixel_m) if ground_spacing_m is None else ground_spacing_m
    height_m = _resample(height_m, pixel_m, step_m, field)
    rows, cols = height_m.shape
    origin_m = (-(cols - 1) * step_m / 2, -(rows - 1) * step_m / 2)
    ground = HeightField(height_m.astype(np.float32), origin_m, step_m)
    return ImportedGround(ground, holes, filled_px)


def read_dem(path: Path, band: int = 1, field: str = "stage.dem") -> Dem:
    """Return the heights in a file.

    Raises:
        InvalidInputError: It cannot be read, or does not contain heights.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        expected = f"a file that ends in {', '.join(SUFFIXES)}"
        raise InvalidInputError(f"{field}.file", str(path), expected)
    if suffix in TIFF_SUFFIXES:
        dem = _read_tiff(path, band, field)
    elif suffix == ".exr":
        dem = Dem(_read_exr(path, field)[::-1], None)
    else:
        dem = Dem(_read_png(path, field)[::-1], None)
    if min(dem.height_m.shape) < 2:
        raise InvalidInputError(f"{field}.file", dem.height_m.shape, "at least 2 x 2 pixels")
    return dem


def write_dem(path: Path, ground: HeightField) -> None:
    """Write a ground as a GeoTIFF with 32-bit heights, which `import_dem` reads without loss.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    import rasterio
    from rasterio.errors import RasterioError

    rows, cols = ground.elevation_m.shape
    x0, _, _, y1 = ground.extent_m
    half_m = ground.spacing_m / 2
    transform = rasterio.transform.from_origin(
        x0 - half_m, y1 + half_m, ground.spacing_m, ground.spacing_m
    )
    local = 'LOCAL_CS["map",UNIT["metre",1]]'
    try:
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            width=cols,
            height=rows,
            count=1,
            dtype="float32",
            crs=local,
            transform=transform,
            compress="deflate",
        ) as file:
            file.write(np.ascontiguousarray(ground.elevation_m[::-1], np.float32), 1)
    except (RasterioError, OSError) as error:
        raise InvalidInputError("path", str(path), f"a place to write to ({error})") from error


def use_of(field: str) -> ImageUse:
    """Return the bounds of a model whose configuration has this name."""
    return replace(ELEVATION, field=f"{field}.file")


def _read_png(path: Path, field: str) -> FloatArray:
    image = read_pixels(path, use_of(field))
    if image.ndim != 2 or image.dtype != np.uint16:
        found = f"{image.shape} {image.dtype}"
        raise InvalidInputError(f"{field}.file", found, f"a grey 16-bit PNG image ({path.name})")
    return np.asarray(image, np.float64)


def _read_exr(path: Path, field: str) -> FloatArray:
    channels = exr.read_channels(path, use_of(field))
    for name in (exr.GREY, "Z", "R", "RGB.R"):
        if name in channels:
            return np.asarray(channels[name], np.float64)
    if len(channels) == 1:
        return np.asarray(next(iter(channels.values())), np.float64)
    raise InvalidInputError(f"{field}.file", sorted(channels), "an image with a channel Y, Z or R")


def _read_tiff(path: Path, band: int, field: str) -> Dem:
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with open_geotiff(path, use_of(field)) as file:
            return _from_dataset(file, band, field)


def _from_dataset(file: Any, band: int, field: str) -> Dem:
    if not 1 <= band <= file.count:
        raise InvalidInputError(f"{field}.band", band, f"a band from 1 to {file.count}")
    unit = (file.units[band - 1] or "").strip().lower()
    if unit not in UNIT_M:
        raise InvalidInputError(f"{field}.file", unit, f"heights in one of {', '.join(UNIT_M)}")
    values = file.read(band, masked=True).astype(np.float64).filled(np.nan)
    height_m = (values * file.scales[band - 1] + file.offsets[band - 1]) * UNIT_M[unit]
    transform = file.transform
    if transform.is_identity:
        return Dem(height_m[::-1], None)
    if abs(transform.b) + abs(transform.d) > 1e-9 * (abs(transform.a) + abs(transform.e)):
        raise InvalidInputError(f"{field}.file", tuple(transform)[:6], "rows from west to east")
    height_m = height_m[:, ::-1] if transform.a < 0 else height_m
    height_m = height_m[::-1] if transform.e < 0 else height_m
    scale_x, scale_y = _unit_m(file, field)
    return Dem(height_m, (abs(transform.a) * scale_x, abs(transform.e) * scale_y))


def _unit_m(file: Any, field: str) -> tuple[float, float]:
    """Return the length in metres of one unit of a file's coordinates, along x and y."""
    crs = file.crs
    if not crs:
        return (1.0, 1.0)
    if not crs.is_geographic:
        # The length unit comes last, after the angle units of the geographic system.
        units = re.findall(r'UNIT\["[^"]*",([\d.eE+-]+)', crs.to_wkt())
        factor = float(units[-1]) if units else 1.0
        return (factor, factor)
    found = re.search(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",([\d.eE+]+),([\d.eE+]+)', crs.to_wkt())
    if found is None:
        expected = "a projected reference system, or a known ellipsoid"
        raise InvalidInputError(f"{field}.file", crs.to_wkt()[:80], expected)
    middle_deg = (file.bounds.bottom + file.bounds.top) / 2
    return degree_m(middle_deg, float(found[1]), float(found[2]))


def degree_m(
    latitude_deg: float, radius_m: float, inverse_flattening: float
) -> tuple[float, float]:
    """Return the length in metres of one degree of longitude and of latitude.

    Args:
        latitude_deg: Latitude of the place.
        radius_m: Equatorial radius of the ellipsoid.
        inverse_flattening: Inverse flattening of the ellipsoid; 0 for a sphere.
    """
    flattening = 1 / inverse_flattening if inverse_flattening else 0.0
    squared = flattening * (2 - flattening)
    latitude = radians(latitude_deg)
    root = sqrt(1 - squared * sin(latitude) ** 2)
    east_m = radius_m * cos(latitude) / root
    north_m = radius_m * (1 - squared) / root**3
    return (east_m * pi / 180, north_m * pi / 180)


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
    if max(counts) > MAX_PX:
        expected = f"at most {MAX_PX} points along an edge (raise ground_spacing_m)"
        raise InvalidInputError(f"{field}.ground_spacing_m", step_m, expected)
    if min(counts) < 2:
        raise InvalidInputError(f"{field}.ground_spacing_m", step_m, "less than the file's extent")
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
    # Cubic if the file has enough points, so that a coarse file shows no facets.
    degrees = [min(3, size - 1) for size in height_m.shape]
    spline = scipy.interpolate.RectBivariateSpline(
        np.arange(height_m.shape[0]),
        np.arange(height_m.shape[1]),
        height_m,
        kx=degrees[0],
        ky=degrees[1],
    )
    return np.asarray(spline(*axes))
