"""The values in files of elevation models, and what the files say about them."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.stage import DemConfig, DemWindowConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.image_formats.image_headers import tiff_header
from oaisys_core.files.image_formats.image_use import ELEVATION, ImageUse
from oaisys_core.files.image_formats.images import decode_pixels, read_file
from oaisys_core.files.image_formats.rasters import open_large_geotiff, open_raster
from oaisys_core.output import exr
from oaisys_core.procedural.terrain.elevation.control_points import (
    STRAIGHT_PX,
    affine_of,
    residual_px,
    straighten,
)
from oaisys_core.procedural.terrain.elevation.netcdf_axes import place_by_axes
from oaisys_core.procedural.terrain.elevation.references import UNIT_M, parse_reference
from oaisys_core.procedural.terrain.elevation.text_grids import check_points, read_text_heights
from oaisys_core.procedural.terrain.elevation.windows import pixels_of
from oaisys_core.types import FloatArray

if TYPE_CHECKING:
    from affine import Affine
    from rasterio.windows import Window

LOG = logging.getLogger(__name__)

PICTURES = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"BM", b"RIFF", b"P2", b"P5", b"P6", b"P3")
"""First bytes of images without a place on a map."""

EXR = b"v/1\x01"

GREY_STEPS = 2
"""Largest difference of red, green and blue in a grey image, which JPEG rounds."""


@dataclass(frozen=True)
class StoredModel:
    """An elevation model as a file stores it.

    Attributes:
        values: (rows, cols) float64 as stored, rows as in the file; NaN where it says so.
        is_image: Whether they are integers of an image that says nothing about heights.
        scale: Units of height per stored unit.
        offset: Height of a stored 0, in units of height.
        unit: Name of the file's own unit of heights; empty if it has none.
        transform: From column and row to x and y; None if the file has no places.
        reference: WKT of the reference system; None if the file has none.
    """

    values: FloatArray
    is_image: bool = False
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    transform: Affine | None = None
    reference: str | None = None


def use_of(field: str) -> ImageUse:
    """Return the bounds of a model whose configuration has this name."""
    return replace(ELEVATION, field=f"{field}.file")


def read_model(config: DemConfig, field: str) -> StoredModel:
    """Return the elevation model in a file, or the part of it that is asked for.

    Args:
        config: The file, and what it does not say itself.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: It cannot be read, or contains no heights.
    """
    if config.window is not None:
        with open_large_geotiff(config.file, use_of(field)) as file:
            return _from_window(file, config, config.window, field)
    path, band, use = config.file, config.band, use_of(field)
    data = read_file(path, use)
    if data.startswith(EXR):
        model = StoredModel(_read_exr(path, field))
    elif data.startswith(PICTURES):
        pixels = decode_pixels(data, use, str(path))
        order = {3: (2, 1, 0), 4: (2, 1, 0, 3)}.get(pixels.shape[-1]) if pixels.ndim == 3 else None
        model = _from_image(pixels if order is None else pixels[..., order], path, band, field)
    else:
        model = _read_raster(data, config, field)
    if min(model.values.shape) < 2:
        raise InvalidInputError(f"{field}.file", model.values.shape, "at least 2 x 2 pixels")
    return model


def _from_image(pixels: NDArray[Any], path: Path, band: int | None, field: str) -> StoredModel:
    """Return the model in the grey, colour and alpha values of an image."""
    planes = pixels[..., None] if pixels.ndim == 2 else pixels
    count = planes.shape[2]
    if not 1 <= (band or 1) <= count:
        raise InvalidInputError(f"{field}.band", band, f"a band from 1 to {count}")
    if band is None and count > 2:
        _check_grey(planes[..., :3], path, field)
    values = planes[..., (band or 1) - 1].astype(np.float64)
    if count in (2, 4):
        values[planes[..., -1] == 0] = np.nan  # transparent
    if planes.dtype == np.uint8:
        LOG.warning(
            "%s: has 8 bits, so its heights have at most 256 steps; slopes will look like terraces",
            path,
        )
    return StoredModel(values, is_image=planes.dtype.kind == "u")


def _check_grey(colors: NDArray[Any], path: Path, field: str) -> None:
    spread = colors.max(axis=2).astype(np.int64) - colors.min(axis=2)
    limit = GREY_STEPS if colors.dtype == np.uint8 else 0
    if spread.max() > limit:
        expected = (
            f"heights, not the colours of a picture ({path.name} is not grey); if a channel does"
            " contain heights, name it: 1 is red, 2 green, 3 blue"
        )
        raise InvalidInputError(f"{field}.band", None, expected)


def _read_exr(path: Path, field: str) -> FloatArray:
    channels = exr.read_channels(path, use_of(field))
    values = _exr_heights(channels, field)
    if "A" in channels and len(channels) > 1:
        values = np.where(channels["A"] == 0, np.nan, values)  # transparent
    return values


def _exr_heights(channels: dict[str, NDArray[Any]], field: str) -> FloatArray:
    named = [name for name in (exr.GREY, "Z") if name in channels]
    if len(named) == 1:
        return np.asarray(channels[named[0]], np.float64)
    if named:
        raise InvalidInputError(f"{field}.file", sorted(channels), "heights in Y or Z, not in both")
    for names in (("R", "G", "B"), ("RGB.R", "RGB.G", "RGB.B")):
        if names[0] not in channels:
            continue
        red = np.asarray(channels[names[0]], np.float64)
        others = [channels[name] for name in names[1:] if name in channels]
        if all(np.array_equal(red, other, equal_nan=True) for other in others):
            return red
        raise InvalidInputError(
            f"{field}.file", sorted(channels), "heights in a channel Y or Z, or in equal R, G and B"
        )
    alone = [name for name in channels if name != "A"] or ["A"]
    if len(alone) == 1:
        return np.asarray(channels[alone[0]], np.float64)
    raise InvalidInputError(f"{field}.file", sorted(channels), "an image with a channel Y, Z or R")


def _read_raster(data: bytes, config: DemConfig, field: str) -> StoredModel:
    from rasterio.errors import NotGeoreferencedWarning

    path, band = config.file, config.band

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with open_raster(data, use_of(field), str(path)) as file:
            check_points(data, file, field)
            model = _from_dataset(file, path, band, field, data=data)
            if file.driver == "GTiff" and model.transform is None:
                _check_upright(data, path, field)
            if file.driver == "netCDF":
                model = place_by_axes(model, data, file, (band or 1) - 1, config, field)
            return model


def _from_window(file: Any, config: DemConfig, window: DemWindowConfig, field: str) -> StoredModel:
    """Return the model in a window of a large file."""
    from affine import Affine
    from rasterio.windows import Window

    system = config.crs or (file.crs and file.crs.to_wkt(version="WKT2_2019"))
    reference = parse_reference(system, f"{field}.file") if system else None
    if reference is None or reference.is_local or file.transform.is_identity:
        expected = "none, because the file has no reference system of a body with its pixels in it"
        raise InvalidInputError(f"{field}.window", str(config.file), expected)
    part = pixels_of(window, reference, file.transform, file.shape, field)
    use_of(field).check(part.columns, part.rows, str(config.file))
    model = _from_dataset(file, config.file, config.band, field, Window(*part))
    moved = file.transform @ Affine.translation(part.column, part.row)
    return replace(model, transform=moved)


def _check_upright(data: bytes, path: Path, field: str) -> None:
    """Raise if the rows of a TIFF without a place do not go from the top to the bottom."""
    try:
        orientation = tiff_header(data).orientation
    except ValueError as error:
        raise use_of(field).refusal(str(path), error) from error
    if orientation != 1:
        expected = "1, the first row at the top and the first column on the left: turn the image"
        raise InvalidInputError(f"{field}.file", f"the TIFF orientation {orientation}", expected)


def _from_dataset(
    file: Any,
    path: Path,
    band: int | None,
    field: str,
    window: Window | None = None,
    data: bytes = b"",
) -> StoredModel:
    """Return the model in a band of a file, or in a window of it; ``data`` is what it contains."""
    if band is not None and not band <= file.count:
        raise InvalidInputError(f"{field}.band", band, f"a band from 1 to {file.count}")
    chosen = (band or 1) - 1
    if band is None:
        _check_no_picture(file, path, field, window)
    unit = (file.units[chosen] or "").strip()
    if unit.lower() not in UNIT_M:
        raise InvalidInputError(
            f"{field}.height_unit", unit, f"heights in one of {', '.join(filter(None, UNIT_M))}"
        )
    if file.dtypes[chosen] == "uint8":
        LOG.warning("%s: has 8 bits, so its heights have at most 256 steps", path)
    scale, offset = float(file.scales[chosen]), float(file.offsets[chosen])
    if scale == 0 or not isfinite(scale) or not isfinite(offset):
        received = f"a scale of {scale:g} and an offset of {offset:g} in band {chosen + 1}"
        expected = "finite numbers, and a scale other than 0"
        raise InvalidInputError(f"{field}.file", received, expected)
    values = read_text_heights(data, file, field)
    if values is None:
        values = _band_values(file, chosen, window)
    is_placed = not file.transform.is_identity
    transform, system = _transform_of(file) if is_placed else None, file.crs
    points, of_points = file.gcps
    if points and not is_placed:
        values, transform = _by_control_points(values, points, of_points, path, field)
        is_placed, system = True, of_points
    says_heights = is_placed or unit != "" or (scale, offset) != (1.0, 0.0)
    return StoredModel(
        values,
        is_image=not says_heights and np.dtype(file.dtypes[chosen]).kind == "u",
        scale=scale,
        offset=offset,
        unit=unit,
        transform=transform,
        reference=system.to_wkt(version="WKT2_2019") if system else None,
    )


def _transform_of(file: Any) -> Affine:
    """Return the transform from the columns and rows that GDAL delivers to x and y."""
    from affine import Affine

    found: Affine = file.transform
    if file.driver == "Terragen":  # the file begins in the south, GDAL delivers the north first
        return Affine(found.a, found.b, found.c, found.d, -abs(found.e), found.f)
    return found


def _band_values(file: Any, chosen: int, window: Window | None) -> FloatArray:
    """Return the values of a band, NaN where anything in the file says that there is none.

    A value for voids, a mask, and a band of alpha: GDAL heeds one of them alone, and alpha only if
    it is of 8 or 16 bits.
    """
    band = file.read(chosen + 1, masked=True, window=window)
    values = np.asarray(band.astype(np.float64).filled(np.nan), np.float64)
    void = file.nodatavals[chosen]
    if void is not None:
        is_float = band.dtype.kind == "f"
        values[values == (float(np.asarray(void, band.dtype)) if is_float else void)] = np.nan
    for number, meaning in enumerate(file.colorinterp):
        if meaning.name == "alpha" and number != chosen:
            values[~(file.read(number + 1, window=window) > 0)] = np.nan
    return values


def _by_control_points(
    values: FloatArray, points: Sequence[Any], system: Any, path: Path, field: str
) -> tuple[FloatArray, Affine]:
    """Return values on a straight grid, and from its columns and rows to x and y."""
    transform = affine_of(points, str(path), field)
    bent_px = residual_px(points, transform)
    LOG.info("%s: %d control points, %.3g px from a straight grid", path, len(points), bent_px)
    if bent_px <= STRAIGHT_PX:
        return values, transform
    if not system:
        expected = "control points with a reference system, because they are not on a straight grid"
        raise InvalidInputError(f"{field}.file", str(path), expected)
    LOG.warning("%s: warped to a straight grid, from which it differs by %.3g px", path, bent_px)
    return straighten(values, points, transform, system), transform


def _check_no_picture(file: Any, path: Path, field: str, window: Window | None) -> None:
    names = [each.name for each in file.colorinterp]
    colors = [number for number, name in enumerate(names) if name in ("red", "green", "blue")]
    if names[0] == "palette":
        expected = f"heights, not the numbers of colours ({path.name} has a palette); if they are"
        raise InvalidInputError(f"{field}.band", None, f"{expected} heights, name the band: 1")
    if 0 in colors:
        planes = file.read([number + 1 for number in colors], window=window)
        _check_grey(np.moveaxis(planes, 0, -1), path, field)
    elif sum(name != "alpha" for name in names) > 1:
        LOG.warning("%s: has %d bands, of which the first is read", path, len(names))
