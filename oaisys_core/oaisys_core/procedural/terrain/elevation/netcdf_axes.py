"""Axes and voids of netCDF-3 files: GDAL guesses which row is north, and takes steps for even."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.elevation.references import (
    UNIT_M,
    Reference,
    parse_reference,
)
from oaisys_core.types import FloatArray

if TYPE_CHECKING:
    from oaisys_core.procedural.terrain.elevation.reading import StoredModel

UNEVEN_PX = 0.02
"""Largest distance of a coordinate from where even steps have it, in pixels."""

_DEGREES = {
    "x": ("degrees_east", "degree_east", "degree_e", "degrees_e", "degreee", "degreese"),
    "y": ("degrees_north", "degree_north", "degree_n", "degrees_n", "degreen", "degreesn"),
}
_PLAIN_DEGREES = ("degrees", "degree", "deg")
_STANDARD_NAMES = {
    "x": ("longitude", "projection_x_coordinate", "grid_longitude"),
    "y": ("latitude", "projection_y_coordinate", "grid_latitude"),
}
_NAMES = {
    "x": ("x", "lon", "long", "longitude", "easting", "eastings"),
    "y": ("y", "lat", "latitude", "northing", "northings"),
}
_DEPTHS = "depth"
"""Part of the standard names of what grows downwards."""

_CONVERT = "convert it (ncpdq -a y,x turns dimensions, gdalwarp makes even steps)"


@dataclass(frozen=True)
class Axis:
    """A coordinate variable.

    Attributes:
        name: Of its dimension.
        kind: ``x``, ``y``, or "" where it does not say.
        first: Its first value.
        step: From each value to the next one.
        unit: In lower case; empty if there is none.
    """

    name: str
    kind: str
    first: float
    step: float
    unit: str

    @property
    def in_degrees(self) -> bool:
        """Whether its values are longitudes or latitudes."""
        return self.unit in (*_DEGREES["x"], *_DEGREES["y"], *_PLAIN_DEGREES)

    @property
    def unit_m(self) -> float | None:
        """Metres per unit; None if it has no unit of length."""
        return UNIT_M.get(self.unit) if self.unit not in ("", "1") else None


def place_by_axes(
    model: StoredModel, data: bytes, file: Any, chosen: int, config: DemConfig, field: str
) -> StoredModel:
    """Return the model of a netCDF file with the rows, places and voids that its variables say.

    Args:
        model: As GDAL reads it.
        data: The file.
        file: The same as a dataset of rasterio.
        chosen: Index of the band.
        config: What the file does not say.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: Its variables say something that is not read.
    """
    content = _open(data, config, field)
    name = file.tags(chosen + 1).get("NETCDF_VARNAME", "")
    variable = content.variables.get(name)
    # SciPy lets attributes of these names replace what a variable is.
    is_plain = variable is not None and isinstance(variable.dimensions, tuple)
    if not is_plain or len(variable.dimensions) < 2 or np.ndim(variable[:]) < 2:
        expected = f"a variable with two dimensions, y and x; {_CONVERT}"
        raise InvalidInputError(f"{field}.file", f"{config.file.name}: {name or 'none'}", expected)
    _check_up(variable, config, field)
    rows = _stored_rows(variable, chosen)
    y, x = (_axis(content, each, config, field) for each in variable.dimensions[-2:])
    _check_order(y, x, variable, field)
    if y is None or x is None:
        if model.transform is not None:
            return model  # by an attribute GeoTransform of GDAL's own
        expected = "a coordinate variable for each dimension, which says which row is north"
        raise InvalidInputError(f"{field}.file", _shown(variable), expected)
    values = _as_stored(model.values, file, chosen, rows, variable, field)
    values = np.where(_is_void(rows, variable, field), np.nan, values)
    return _place(replace(model, values=values), y, x, config, field)


def _open(data: bytes, config: DemConfig, field: str) -> Any:
    from scipy.io import netcdf_file

    try:
        return netcdf_file(io.BytesIO(data), mmap=False, maskandscale=False)
    except Exception as error:  # SciPy raises whatever a damaged header leads to
        expected = f"a netCDF-3 file of the classic formats that can be read ({error})"
        raise InvalidInputError(f"{field}.file", str(config.file), expected) from error


def _text(variable: Any, name: str) -> str:
    found = getattr(variable, name, b"")
    return found.decode("utf-8", "replace").strip() if isinstance(found, bytes) else ""


def _shown(variable: Any) -> str:
    return f"dimensions ({', '.join(variable.dimensions)})"


def _check_up(variable: Any, config: DemConfig, field: str) -> None:
    """Raise if the values grow downwards, and nothing turns them."""
    name, positive = _text(variable, "standard_name"), _text(variable, "positive").lower()
    if (positive == "down" or _DEPTHS in name.lower()) and config.scale > 0:
        found = "positive: down" if positive == "down" else f"standard_name: {name}"
        expected = "a negative one, such as -1, because the file has depths"
        raise InvalidInputError(f"{field}.scale", f"{config.scale:g} ({found})", expected)


def _axis(content: Any, name: str, config: DemConfig, field: str) -> Axis | None:
    """Return a coordinate variable with even steps; None if the dimension has none."""
    variable = content.variables.get(name)
    if variable is None or variable.dimensions != (name,):
        return None
    stored = np.asarray(variable[:])
    if not _is_even(stored):
        found = f"{config.file.name}: {name} from {stored[:3].tolist()} to {stored[-2:].tolist()}"
        expected = f"coordinates in even steps; {_CONVERT}"
        raise InvalidInputError(f"{field}.file", found, expected)
    values = stored.astype(np.float64)
    step = float(values[-1] - values[0]) / (len(values) - 1)
    unit = _text(variable, "units").lower()
    return Axis(name, _kind(name, variable), float(values[0]), step, unit)


def _is_even(stored: NDArray[Any]) -> bool:
    """Return whether coordinates have even steps, but for the rounding of 32-bit floats."""
    if stored.ndim != 1 or len(stored) < 2 or stored.dtype.kind not in "iuf":
        return False
    values = stored.astype(np.float64)
    even = np.linspace(values[0], values[-1], len(values))
    rounding = 2 * float(np.finfo(stored.dtype).eps) if stored.dtype.kind == "f" else 0.0
    bound = max(UNEVEN_PX * abs(even[1] - even[0]), rounding * np.abs(values).max())
    return bool(even[0] != even[-1] and (np.abs(values - even) <= bound).all())


def _kind(name: str, variable: Any) -> str:
    """Return whether a coordinate variable is ``x`` or ``y``: CF's attributes, else its name."""
    unit, standard_name = _text(variable, "units").lower(), _text(variable, "standard_name")
    for kind in ("x", "y"):
        if _text(variable, "axis").lower() == kind or unit in _DEGREES[kind]:
            return kind
        if standard_name in _STANDARD_NAMES[kind]:
            return kind
    return next((kind for kind, names in _NAMES.items() if name.lower() in names), "")


def _check_order(y: Axis | None, x: Axis | None, variable: Any, field: str) -> None:
    """Raise unless the last two dimensions are y and x, in this order."""
    kinds = ["y" if y is None else y.kind, "x" if x is None else x.kind]
    if kinds != ["y", "x"]:
        expected = (
            "the last two to be y and x, as standard_name, axis, units or names such as lat and lon"
            f" say; {_CONVERT}"
        )
        raise InvalidInputError(f"{field}.file", _shown(variable), expected)


def _stored_rows(variable: Any, chosen: int) -> NDArray[Any]:
    """Return the (rows, cols) values of a band as the file has them."""
    rows = np.asarray(variable[:])
    rows = rows.reshape(-1, *rows.shape[-2:])[min(chosen, rows[..., 0, 0].size - 1)]
    return np.asarray(rows, rows.dtype.newbyteorder("="))


def _as_stored(
    values: FloatArray, file: Any, chosen: int, rows: NDArray[Any], variable: Any, field: str
) -> FloatArray:
    """Return values, NaN where there are none, in the order in which the file has its rows."""
    if rows.dtype.kind != "f" and rows.dtype.itemsize == np.dtype(file.dtypes[chosen]).itemsize:
        rows = rows.view(file.dtypes[chosen])  # bytes may have no sign
    for turned in (values, values[::-1]):
        if turned.shape == rows.shape and (np.isnan(turned) | (turned == rows)).all():
            return turned
    expected = f"a variable that GDAL reads as it is stored; {_CONVERT}"
    raise InvalidInputError(f"{field}.file", _shown(variable), expected)


def _is_void(rows: NDArray[Any], variable: Any, field: str) -> NDArray[np.bool_]:
    """Return where stored values are no heights: GDAL heeds one of these attributes alone."""
    void = np.zeros(rows.shape, bool)
    for name in ("_FillValue", "missing_value"):
        for value in _numbers(variable, name, field):
            void |= rows == value
    ends = _numbers(variable, "valid_range", field)
    least = [*ends[:1], *_numbers(variable, "valid_min", field)]
    most = [*ends[-1:], *_numbers(variable, "valid_max", field)]
    is_packed = hasattr(variable, "scale_factor") or hasattr(variable, "add_offset")
    for value in (*least, *most):
        if is_packed and (value.dtype.kind == "f") != (rows.dtype.kind == "f"):
            expected = "valid_range, valid_min and valid_max of the type of the packed values"
            raise InvalidInputError(f"{field}.file", f"{value} of type {value.dtype}", expected)
    for value in least:
        void |= rows < value
    for value in most:
        void |= rows > value
    return void


def _numbers(variable: Any, name: str, field: str) -> NDArray[Any]:
    """Return the numbers in an attribute; none if there is no such attribute."""
    found = np.atleast_1d(getattr(variable, name, np.empty(0)))
    if found.dtype.kind not in "iuf" or (name == "valid_range" and len(found) not in (0, 2)):
        expected = "numbers, two of them in valid_range"
        raise InvalidInputError(f"{field}.file", f"{name}: {getattr(variable, name)}", expected)
    return found


def _place(model: StoredModel, y: Axis, x: Axis, config: DemConfig, field: str) -> StoredModel:
    """Return a model with a transform in the unit of its reference system, or its north first."""
    text = config.crs or model.reference
    reference = parse_reference(text, f"{field}.crs") if text else None
    scales = [_unit_of_system(axis, reference, field) for axis in (x, y)]
    if reference is None and None in scales:
        if (x.in_degrees or y.in_degrees) and config.spacing_m is None and config.size_m is None:
            expected = (
                f"a reference system, because {y.name} and {x.name} of {config.file.name} are"
                f" degrees, such as EPSG:4326; or {field}.spacing_m"
            )
            raise InvalidInputError(f"{field}.crs", None, expected)
        values = model.values[:: -1 if y.step > 0 else 1, :: -1 if x.step < 0 else 1]
        return replace(model, values=values, transform=None)
    (x_scale, y_scale) = (scale or 1.0 for scale in scales)
    return replace(model, transform=_transform(y, x, y_scale, x_scale, reference))


def _unit_of_system(axis: Axis, reference: Reference | None, field: str) -> float | None:
    """Return units of the reference system, else metres, per unit of an axis; None if unknown."""
    if reference is None:
        return axis.unit_m
    if not axis.unit:
        return 1.0
    is_geographic = reference.horizontal.is_geographic
    if is_geographic != axis.in_degrees or (not is_geographic and axis.unit_m is None):
        expected = f"coordinates in the unit of {reference.horizontal.name}, {reference.unit_name}"
        raise InvalidInputError(f"{field}.file", f"{axis.name} in {axis.unit}", expected)
    return 1.0 if is_geographic else (axis.unit_m or 1.0) / reference.unit_m


def _transform(
    y: Axis, x: Axis, y_scale: float, x_scale: float, reference: Reference | None
) -> Any:
    """Return the transform from column and row to x and y, whose values are those of centres."""
    from affine import Affine

    is_geographic = reference is not None and reference.horizontal.is_geographic
    turns = 360 if is_geographic and min(x.first, x.first + x.step) >= 180 else 0
    return Affine(
        x_scale * x.step, 0.0, x_scale * (x.first - turns - x.step / 2),
        0.0, y_scale * y.step, y_scale * (y.first - y.step / 2),
    )  # fmt: skip
