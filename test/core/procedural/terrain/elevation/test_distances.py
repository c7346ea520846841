"""True distances on grounds from files, judged by geodesics of PROJ on the ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
import scipy
from rasterio.transform import Affine

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.procedural.terrain.dem import import_dem
from oaisys_core.scene import HeightField

PX = 161
HILLS = ((35, 40), (120, 50), (60, 125), (118, 118))
"""Columns and rows of hills in the files, none in line with another."""


@dataclass(frozen=True)
class Case:
    """An area of a map.

    Attributes:
        crs: Its reference system.
        middle: Longitude and latitude of its middle, in the reference system's own datum.
        pixel: Pixel in units of the system.
        up: Whether row 0 is in the south.
    """

    crs: str
    middle: tuple[float, float]
    pixel: float
    up: bool = False


ROTATED_POLE = pyproj.crs.DerivedGeographicCRS(
    base_crs=pyproj.CRS("EPSG:4326"),
    conversion=pyproj.crs.coordinate_operation.RotatedLatitudeLongitudeConversion(39.25, 0, 18),
).to_wkt()

NOT_IN_GEOTIFF = (ROTATED_POLE, "IAU_2015:49901", "IAU_2015:49911")
"""A GeoTIFF holds neither other poles nor longitudes to the west."""

CASES = {
    "web mercator, 48 degrees": Case("EPSG:3857", (9.8, 48.0), 2.0),
    "web mercator, 60 degrees, 50 m": Case("EPSG:3857", (10.0, 60.0), 50.0),
    "web mercator, wide": Case("EPSG:3857", (10.0, 60.0), 900.0),
    "degrees": Case("EPSG:4326", (11.0, 46.5), 1e-5),
    "degrees, one of them": Case("EPSG:4326", (11.0, 46.5), 1 / 160),
    "degrees, row 0 in the south": Case("EPSG:4326", (11.0, -46.5), 1 / 160, up=True),
    "grads": Case("EPSG:4807", (2.3, 46.5), 1e-4),
    "UTM at its edge": Case("EPSG:32633", (18.0, 50.0), 5.0),
    "UTM far beyond its edge": Case("EPSG:32633", (27.0, 50.0), 100.0),
    "feet": Case("EPSG:2263", (-73.9, 40.7), 3.0),
    "LV03": Case("EPSG:21781", (9.8, 46.8), 2.0),
    "an oblique pole": Case(ROTATED_POLE, (11.0, 60.0), 0.01),
    "equal areas of Europe": Case("EPSG:3035", (-8.0, 38.0), 25.0),
    "south orientated": Case("EPSG:2053", (28.2, -25.7), 4.0),
    "polar, at the pole": Case("EPSG:3413", (0.0, 89.99), 20.0),
    "polar, beside it": Case("EPSG:3413", (-40.0, 72.0), 20.0),
    "Moon, far from the standard parallel": Case("IAU_2015:30110", (30.0, 65.0), 20.0),
    "Moon, at the south pole": Case("IAU_2015:30135", (20.0, -89.0), 20.0),
    "Mars, degrees to the west": Case("IAU_2015:49901", (137.4, -4.6), 1e-3),
    "Mars, degrees to the west, wide": Case("IAU_2015:49901", (137.4, -34.6), 1 / 100),
    "Mars, westing, small": Case("IAU_2015:49911", (60.0, 50.0), 3.0),
    "Mars, westing": Case("IAU_2015:49911", (60.0, 50.0), 30.0),
    "Mars, sphere": Case("IAU_2015:49910", (77.5, 18.4), 20.0),
}


def geographic(case: Case) -> pyproj.CRS:
    """Longitude, to the east, and latitude in the datum of a case."""
    if case.crs == ROTATED_POLE:
        return pyproj.CRS("EPSG:4326")
    base = pyproj.CRS.from_user_input(case.crs).geodetic_crs
    assert base is not None
    return pyproj.crs.GeographicCRS(datum=base.datum)


def write_hills(path: Path, case: Case) -> np.ndarray:
    """Write the file, and return (n, 2) longitudes, to the east, and latitudes of its hills."""
    crs = pyproj.CRS.from_user_input(case.crs)
    to_crs = pyproj.Transformer.from_crs(geographic(case), crs, always_xy=True)
    # Rasters have x first. PROJ knows that, but not of longitudes to the west.
    order = -1 if case.crs == "IAU_2015:49901" else 1
    x, y = to_crs.transform(*case.middle)[::order]
    step_y = case.pixel if case.up else -case.pixel
    transform = Affine(case.pixel, 0, x - PX / 2 * case.pixel, 0, step_y, y - PX / 2 * step_y)
    row, col = np.mgrid[:PX, :PX]
    height_m = sum(
        (50 + 10 * n) * np.exp(-((col - c) ** 2 + (row - r) ** 2) / (2 * 3.0**2))
        for n, (c, r) in enumerate(HILLS)
    )
    shape = {"width": PX, "height": PX, "count": 1, "dtype": "float32"}
    with rasterio.open(
        path, "w", driver="GTiff", crs=crs.to_wkt(), transform=transform, **shape
    ) as file:
        file.write(np.float32(height_m), 1)
    c, r = np.array(HILLS, float).T + 0.5
    first, second = (transform.a * c + transform.c, transform.e * r + transform.f)[::order]
    return np.stack(to_crs.transform(first, second, direction="INVERSE"), axis=1)


def hills_of(ground: HeightField) -> np.ndarray:
    """(n, 2) places on the ground, from the lowest hill to the highest."""
    height_m = ground.elevation_m.astype(float)
    found = []
    labels, count = scipy.ndimage.label(height_m > 15)
    assert count == len(HILLS)
    for number in range(1, count + 1):
        weight = np.where(labels == number, height_m - 15, 0)
        row, col = scipy.ndimage.center_of_mass(weight)
        x0, y0, _, _ = ground.extent_m
        place = (x0 + col * ground.spacing_m, y0 + row * ground.spacing_m)
        found.append((height_m[labels == number].max(), place))
    return np.array([place for _, place in sorted(found)])


@pytest.mark.parametrize("name", CASES)
def test_distances_are_those_on_the_body(tmp_path: Path, name: str) -> None:
    case = CASES[name]
    lon_lat = write_hills(tmp_path / "hills.tif", case)
    units = {"height_unit": "m"} if case.crs == "EPSG:2263" else {}
    if case.crs in NOT_IN_GEOTIFF:
        units["crs"] = case.crs
    config = DemConfig(file=tmp_path / "hills.tif", offset_m=0.0, **units)
    ground = import_dem(config).ground
    geod = geographic(case).get_geod()
    assert geod is not None
    places = hills_of(ground)
    middle = np.array(case.middle)
    turn = []
    for a in range(len(HILLS)):
        # From the middle, which is the origin; and between hills, unless the map is of a country.
        azimuth, _, true_m = geod.inv(*middle, *lon_lat[a])
        assert hypot(*places[a]) == pytest.approx(true_m, rel=1e-3, abs=0.1 * ground.spacing_m)
        turn.append(azimuth - np.degrees(np.arctan2(*places[a])))
        for b in range(a):
            _, _, true_m = geod.inv(*lon_lat[a], *lon_lat[b])
            found_m = hypot(*(places[a] - places[b]))
            assert found_m == pytest.approx(true_m, rel=1.2e-3, abs=0.1 * ground.spacing_m)
    turn = (np.array(turn) - turn[0] + 180) % 360 - 180 + turn[0]
    assert np.ptp(turn) < 0.3, "directions differ by one angle, that of the map's north"
    if "polar" not in name and "pole" not in name:
        assert abs((turn[0] + 180) % 360 - 180) < 13, "north is along +y"
