"""Reference systems: true distances between pixels, and the unit of heights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, Georeference

if TYPE_CHECKING:
    from affine import Affine
    from pyproj import CRS, Geod, Transformer

SAMPLES = 7
"""Points along each edge of a raster at which the scale is measured."""

UNIT_M = {
    "": 1.0,
    "1": 1.0,
    **dict.fromkeys(("m", "metre", "meter", "metres", "meters"), 1.0),
    **dict.fromkeys(("km", "kilometre", "kilometer", "kilometres", "kilometers"), 1000.0),
    **dict.fromkeys(("cm", "centimetre", "centimeter", "centimetres", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimeter", "millimetres", "millimeters"), 0.001),
    **dict.fromkeys(("dm", "decimetre", "decimeter", "decimetres", "decimeters"), 0.1),
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 0.3048),
    **dict.fromkeys(("us survey foot", "us survey feet", "us-ft", "ftus", "foot_us"), 1200 / 3937),
    **dict.fromkeys(("yd", "yard", "yards"), 0.9144),
    **dict.fromkeys(("fathom", "fathoms"), 1.8288),
}
"""Metres per unit of height, by the names of units in files."""


@dataclass(frozen=True)
class LocalScale:
    """What a step of one pixel is on the ground, along the image's columns and rows.

    Attributes:
        pixel_m: Width and height of the pixel in the image's middle.
        right_deg: Azimuth, from true north, in which the columns increase there.
        up_deg: Azimuth in which the rows decrease there.
        variation: How far widths, heights and the angle between them differ across the image: a
            share, and radians.
    """

    pixel_m: tuple[float, float]
    right_deg: float
    up_deg: float
    variation: float


@dataclass(frozen=True)
class Reference:
    """The reference system of a file.

    Attributes:
        horizontal: The system of its x and y.
        height_unit_m: Metres per unit of its heights, negative for depths; None if it has none.
        height_name: What its heights are, in the log.
    """

    horizontal: CRS
    height_unit_m: float | None
    height_name: str

    @property
    def is_local(self) -> bool:
        """Whether x and y are no places on a body."""
        return self.horizontal.geodetic_crs is None

    @property
    def unit_m(self) -> float:
        """Metres per unit of x, of a system that is local or projected."""
        return float(self.horizontal.axis_info[0].unit_conversion_factor)

    @property
    def unit_name(self) -> str:
        """Unit of x and y."""
        return self.horizontal.axis_info[0].unit_name

    @property
    def is_turned(self) -> bool:
        """Whether x grows to the west and y to the south."""
        return _directions(self.horizontal) == ["west", "south"]

    @property
    def is_to_the_west(self) -> bool:
        """Whether x is a longitude that grows to the west, as of some planets."""
        return _directions(self.horizontal) == ["north", "west"]

    @cached_property
    def geodetic(self) -> CRS:
        """The system of longitude, to the east, and latitude that it is based on."""
        found = self.horizontal.geodetic_crs
        assert found is not None
        if found.is_derived and found.source_crs is not None:
            found = found.source_crs  # a rotated pole is derived from true longitude and latitude
        unit = found.axis_info[0].unit_name
        return found if "west" not in _directions(found) and unit == "degree" else _plain(found)

    @cached_property
    def geod(self) -> Geod:
        """Geodesics on its ellipsoid."""
        found = self.geodetic.get_geod()
        assert found is not None
        return found

    @cached_property
    def _to_geodetic(self) -> Transformer:
        from pyproj import Transformer

        return Transformer.from_crs(self.horizontal, self.geodetic, always_xy=True)

    def lon_lat_deg(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return longitude, to the east, and latitude; not finite where x and y are no place."""
        if self.is_to_the_west:
            x, y = y, x  # PROJ knows the order of rasters only where longitude grows to the east
        lon, lat = self._to_geodetic.transform(x, y)
        return np.asarray(lon), np.asarray(lat)

    def x_y(self, lon_deg: FloatArray, lat_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and y of places; inverse of `lon_lat_deg`."""
        x, y = self._to_geodetic.transform(lon_deg, lat_deg, direction="INVERSE")
        if self.is_to_the_west:
            x, y = y, x
        return np.asarray(x), np.asarray(y)


def _directions(crs: CRS) -> list[str]:
    return [axis.direction for axis in crs.axis_info[:2]]


def _plain(crs: CRS) -> CRS:
    """Return a geographic system in degrees, with longitude to the east, with the same datum."""
    from pyproj.crs import GeographicCRS

    return GeographicCRS(name=crs.name, datum=crs.datum)


def parse_reference(text: str, field: str) -> Reference:
    """Return a reference system.

    Args:
        text: WKT, or a name such as EPSG:32633.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: There is no such system, or its x and y are no map's.
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        crs = CRS.from_user_input(text)
    except CRSError as error:
        raise InvalidInputError(
            field, text, f"a reference system that PROJ knows ({error})"
        ) from error
    parts = crs.sub_crs_list if crs.is_compound else [crs]
    horizontal, axes = parts[0], [axis for part in parts for axis in part.axis_info]
    while horizontal.is_bound and horizontal.source_crs is not None:
        horizontal = horizontal.source_crs
    if horizontal.is_geocentric or len(axes) < 2:
        expected = "a projected or geographic reference system, or a local one"
        raise InvalidInputError(field, horizontal.name, expected)
    vertical = axes[2] if len(axes) > 2 else None
    if vertical is None:
        return Reference(horizontal, None, "heights without a reference system")
    sign = -1.0 if vertical.direction == "down" else 1.0
    name = f"{vertical.name} ({parts[-1].name}) in {vertical.unit_name}"
    return Reference(horizontal, sign * float(vertical.unit_conversion_factor), name)


def coordinates(
    transform: Affine, col: FloatArray, row: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return x and y of places in an image, whose first pixel's centre is at 0.5, 0.5."""
    x = transform.a * col + transform.b * row + transform.c
    y = transform.d * col + transform.e * row + transform.f
    return x, y


def georeference_of_pixels(
    reference: Reference,
    transform: Affine,
    shape: tuple[int, ...],
    steps: tuple[float, float],
) -> Georeference:
    """Return where a grid lies whose pixels are those of an image, its middle at the origin.

    Args:
        reference: Of the image's x and y.
        transform: From column and row to x and y.
        shape: Rows and columns.
        steps: Columns per metre along +x, and rows per metre along +y.
    """
    from affine import Affine

    crs = reference.horizontal
    if reference.is_to_the_west:
        t = transform
        crs, transform = reference.geodetic, Affine(-t.a, -t.b, -t.c, t.d, t.e, t.f)
    rows, cols = shape
    pixels = Affine(steps[0], 0.0, cols / 2, 0.0, steps[1], rows / 2)
    a, b, c, d, e, f, *_ = transform * pixels
    return Georeference(crs.to_wkt(), (a, b, c, d, e, f), 0.0)


def measure_scale(
    reference: Reference, transform: Affine, shape: tuple[int, ...], field: str
) -> LocalScale:
    """Return the true size of pixels, by geodesics along and across pixels of the image.

    Args:
        reference: Not local.
        transform: From column and row to x and y.
        shape: Rows and columns.
        field: Name of the configuration field in errors.

    Raises:
        InvalidInputError: Some pixels are no places on the body.
    """
    rows, cols = shape
    step = max(1.0, min(rows, cols) / 100)
    col, row = np.meshgrid(
        np.linspace((step + 1) / 2, cols - (step + 1) / 2, SAMPLES),
        np.linspace((step + 1) / 2, rows - (step + 1) / 2, SAMPLES),
    )
    width_m, right_deg = _measure(reference, transform, (col, row), (step, 0.0))
    height_m, up_deg = _measure(reference, transform, (col, row), (0.0, -step))
    if not np.isfinite([width_m, height_m]).all() or min(width_m.min(), height_m.min()) <= 0:
        found = f"corner {transform.c}, {transform.f} in {reference.horizontal.name}"
        expected = f"an image inside the area of its reference system ({field}.spacing_m overrides)"
        raise InvalidInputError(f"{field}.file", found, expected)
    middle = SAMPLES // 2, SAMPLES // 2
    skew = np.abs(np.cos(np.radians(right_deg - up_deg)))
    variation = max(
        float(np.ptp(width_m) / width_m[middle]),
        float(np.ptp(height_m) / height_m[middle]),
        float(skew.max()),
    )
    return LocalScale(
        (float(width_m[middle]), float(height_m[middle])),
        float(right_deg[middle]),
        float(up_deg[middle]),
        variation,
    )


def _measure(
    reference: Reference,
    transform: Affine,
    place: tuple[FloatArray, FloatArray],
    step: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Return the length in metres of one pixel in the direction of a step, and its azimuth."""
    lon_lat = []
    for share in (-0.5, 0.0, 0.5):
        col, row = place[0] + share * step[0], place[1] + share * step[1]
        lon_lat.append(reference.lon_lat_deg(*coordinates(transform, col, row)))
    start, middle, end = lon_lat
    _, _, length_m = reference.geod.inv(*start, *end)
    azimuth_deg, _, _ = reference.geod.inv(*middle, *end)
    return np.asarray(length_m) / max(map(abs, step)), np.asarray(azimuth_deg)
