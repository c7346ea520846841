"""Elevation models in files become grounds."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.elevation.placement import place_on_ground
from oaisys_core.procedural.terrain.elevation.reading import StoredModel, read_model
from oaisys_core.procedural.terrain.elevation.references import Reference, parse_reference
from oaisys_core.procedural.terrain.elevation.units import height_unit_m
from oaisys_core.procedural.terrain.elevation.voids import check_for_voids, find_missing
from oaisys_core.procedural.terrain.ground_checks import HEIGHTS_EXPECTED, are_heights, check_extent
from oaisys_core.procedural.terrain.holes import fill_holes, number_of_holes
from oaisys_core.scene import HeightField
from oaisys_core.types import FloatArray, Georeference

LOG = logging.getLogger(__name__)

_FIELD = "stage.dem"
"""Name of the configuration field in errors."""


@dataclass(frozen=True)
class ImportedGround:
    """A ground from a file, and how many missing heights were filled.

    Attributes:
        holes: Number of connected regions without heights, which were filled.
        filled_px: Number of pixels in these regions.
        body_radius_m: Equatorial radius of the body that the file is of; None if it does not say.
        posting_m: Distance between the heights in the file, on the ground.
        georeference: Where ``map`` lies on the body; None if the file does not say.
    """

    ground: HeightField
    holes: int
    filled_px: int
    body_radius_m: float | None = None
    posting_m: float = 0.0
    georeference: Georeference | None = None


def import_dem(config: DemConfig) -> ImportedGround:
    """Return the ground of a file, centred on the origin, with north along +y.

    Args:
        config: The file, and what it does not say itself.

    Raises:
        InvalidInputError: The file cannot be read or used, or does not define its pixel size.
    """
    model = read_model(config, _FIELD)
    reference = _reference(model, config, _FIELD)
    missing = find_missing(model.values, config.nodata)
    if missing.all():
        raise InvalidInputError(f"{_FIELD}.file", str(config.file), "an image with heights in it")
    factor_m, zero_m = _height_factor(model, reference, missing, config, _FIELD)
    if config.nodata != "none":
        check_for_voids(model.values[~missing], factor_m, _FIELD)
    holes, filled_px = _tell_holes(missing, config.file)
    height_m = np.where(missing, 0.0, model.values) * factor_m + zero_m
    offset_m = config.offset_m
    if offset_m is None:
        # What fills the holes does not count.
        offset_m = 0.0 if config.size_m else -float(np.median(height_m[~missing]))
    height_m = fill_holes(height_m, missing)
    height_m += offset_m
    if config.position_m[2]:
        height_m += config.position_m[2]
    placed = place_on_ground(height_m, model.transform, reference, config, _FIELD)
    height_m, step_m, place = placed
    _check_range(height_m, _FIELD)
    rows, cols = height_m.shape
    x_m, y_m, _ = config.position_m
    origin_m = (x_m - (cols - 1) * step_m / 2, y_m - (rows - 1) * step_m / 2)
    ground = HeightField(height_m.astype(np.float32), origin_m, step_m)
    check_extent(ground, config.file, f"{_FIELD}.file")
    body_m = None if reference is None or reference.is_local else float(reference.geod.a)
    intervals = zip(height_m.shape, model.values.shape, strict=True)
    posting_m = step_m * max((grid - 1) / max(file - 1, 1) for grid, file in intervals)
    if place is not None:
        place = replace(
            place.with_offset(x_m, y_m), height_offset_m=offset_m + config.position_m[2]
        )
    return ImportedGround(ground, holes, filled_px, body_m, posting_m, place)


def _reference(model: StoredModel, config: DemConfig, field: str) -> Reference | None:
    if config.crs is not None:
        if model.transform is None:
            expected = f"none, because {config.file.name} says no coordinates of its pixels"
            raise InvalidInputError(f"{field}.crs", config.crs, expected)
        return parse_reference(config.crs, f"{field}.crs")
    return None if model.reference is None else parse_reference(model.reference, f"{field}.file")


def _height_factor(
    model: StoredModel,
    reference: Reference | None,
    missing: NDArray[np.bool_],
    config: DemConfig,
    field: str,
) -> tuple[float, float]:
    """Return metres per stored unit, and the height of a stored 0."""
    if config.size_m is not None:
        if not model.is_image:
            expected = f"none, because {config.file.name} has heights, not the steps of an image"
            raise InvalidInputError(f"{field}.size_m", config.size_m, expected)
        # As Gazebo: the largest value of the image is as high as the model.
        largest = float(model.values[~missing].max())
        return config.size_m[2] / (largest or 1.0), 0.0
    unit_m = config.scale * height_unit_m(model, reference, config.height_unit, field)
    return model.scale * unit_m, model.offset * unit_m


def _tell_holes(missing: NDArray[np.bool_], file: Path) -> tuple[int, int]:
    """Return the number of holes and of pixels in them, and log them."""
    holes, filled_px = number_of_holes(missing), int(missing.sum())
    if holes:
        share = 100 * missing.mean()
        LOG.warning("%s: filled %d holes, %d pixels (%.2f %%)", file, holes, filled_px, share)
    return holes, filled_px


def _check_range(height_m: FloatArray, field: str) -> None:
    if not are_heights(height_m):
        highest_m = float(np.abs(height_m).max())
        raise InvalidInputError(
            f"{field}.file", f"a height of {highest_m:.12g} m", HEIGHTS_EXPECTED
        )


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
