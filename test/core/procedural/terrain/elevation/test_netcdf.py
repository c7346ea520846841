"""netCDF-3 files, written by SciPy: their coordinate variables say where their rows are."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.transform import from_origin
from scipy.io import netcdf_file

from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.dem import ImportedGround, import_dem

ROWS, COLS = 40, 50
X_M = 5001.0 + 2.0 * np.arange(COLS)
NORTH_FIRST_M = 1001.0 + 2.0 * np.arange(ROWS)[::-1]
METRES = {
    "x": {"units": "m", "standard_name": "projection_x_coordinate"},
    "y": {"units": "m", "standard_name": "projection_y_coordinate"},
}
DEGREES = {"lon": {"units": "degrees_east"}, "lat": {"units": "degrees_north"}}


def heights() -> NDArray[np.float32]:
    """A peak in the north west, at row 5 from the north and column 8."""
    row, col = np.mgrid[:ROWS, :COLS]
    peak = 30 * np.exp(-((col - 8) ** 2 + (row - 5) ** 2) / 30)
    return np.asarray(300 + peak, np.float32)


def write(
    path: Path,
    y: NDArray[Any],
    x: NDArray[Any],
    z: NDArray[Any],
    dims: tuple[str, ...] = ("y", "x"),
    attributes: dict[str, dict[str, Any]] | None = None,
    mapping: dict[str, Any] | None = None,
    **of_z: Any,
) -> Path:
    """Write a file of classic netCDF, in which the last name of ``dims`` is not always x."""
    sizes = dict(zip(dims, z.shape, strict=True))
    with netcdf_file(path, "w") as file:
        for name in dims:
            file.createDimension(name, sizes[name])
            values = {"y": y, "lat": y, "x": x, "lon": x}.get(name)
            if values is None:
                continue
            variable = file.createVariable(name, values.dtype, (name,))
            variable[:] = values
            for key, value in (attributes or {}).get(name, {}).items():
                setattr(variable, key, value)
        if mapping is not None:
            crs = file.createVariable("crs", "i4", ())
            of_z["grid_mapping"] = "crs"
            for key, value in mapping.items():
                setattr(crs, key, value)
            file.Conventions = "CF-1.7"
        variable = file.createVariable("z", z.dtype, dims)
        variable[:] = z
        for key, value in of_z.items():
            setattr(variable, key, value)
    return path


def read(path: Path, **keys: Any) -> ImportedGround:
    return import_dem(DemConfig(file=path, offset_m=0.0, **keys))


def peak(found: ImportedGround) -> tuple[int, int]:
    """Return the row from the north, and the column, of the highest point."""
    row, col = np.unravel_index(found.ground.elevation_m.argmax(), found.ground.elevation_m.shape)
    return found.ground.elevation_m.shape[0] - 1 - int(row), int(col)


@pytest.mark.parametrize("attributes", [{}, METRES])
@pytest.mark.parametrize("is_north_first", [True, False])
@pytest.mark.parametrize("is_west_first", [True, False])
def test_the_coordinates_say_which_row_is_north(
    attributes: dict[str, Any], is_north_first: bool, is_west_first: bool, tmp_path: Path
) -> None:
    rows, cols = 1 if is_north_first else -1, 1 if is_west_first else -1
    z = heights()[::rows, ::cols]
    path = write(tmp_path / "a.nc", NORTH_FIRST_M[::rows], X_M[::cols], z, attributes=attributes)
    found = read(path, spacing_m=2.0)
    assert peak(found) == (5, 8)
    np.testing.assert_array_equal(found.ground.elevation_m[::-1], heights())
    if attributes:
        assert read(path).ground.spacing_m == 2.0
        assert peak(read(path)) == (5, 8)
    else:
        with pytest.raises(InvalidInputError, match="spacing_m"):
            read(path)


@pytest.mark.parametrize("dtype", ["f4", "f8", "i2", "i4"])
def test_rows_are_those_of_the_file_for_all_types(dtype: str, tmp_path: Path) -> None:
    z = np.rint(heights()).astype(dtype)
    for name, rows in (("north.nc", 1), ("south.nc", -1)):
        path = write(tmp_path / name, NORTH_FIRST_M[::rows], X_M, z[::rows])
        assert peak(read(path, spacing_m=2.0)) == (5, 8)


@pytest.mark.parametrize("unit", [("m", 1.0), ("km", 1000.0), ("feet", 0.3048)])
def test_axes_without_a_reference_system_have_their_unit(
    unit: tuple[str, float], tmp_path: Path
) -> None:
    name, unit_m = unit
    axes = {axis: attributes | {"units": name} for axis, attributes in METRES.items()}
    path = write(
        tmp_path / "a.nc", NORTH_FIRST_M / unit_m, X_M / unit_m, heights(), attributes=axes
    )
    found = read(path)
    assert found.ground.spacing_m == pytest.approx(2.0)
    assert peak(found) == (5, 8)


@pytest.mark.parametrize("step_deg", [0.2, 1e-4])
def test_degrees_need_a_reference_system(step_deg: float, tmp_path: Path) -> None:
    lat, lon = 46 - step_deg * np.arange(ROWS), 7.0 + step_deg * np.arange(COLS)
    path = write(tmp_path / "a.nc", lat, lon, heights(), ("lat", "lon"), DEGREES)
    with pytest.raises(InvalidInputError, match=r"crs: .* lat and lon of a\.nc are degrees"):
        read(path)
    assert peak(read(path, spacing_m=2.0)) == (5, 8)


def test_degrees_with_a_reference_system_are_true_distances(tmp_path: Path) -> None:
    lat, lon = 46 + 1e-4 * np.arange(ROWS), 352.4 + 1e-4 * np.arange(COLS)
    path = write(tmp_path / "a.nc", lat, lon, heights()[::-1], ("lat", "lon"), DEGREES)
    found = read(path, crs="EPSG:4326")
    _, _, height_m = pyproj.Geod(ellps="WGS84").inv(-7.6, lat[0], -7.6, lat[-1])
    rows = found.ground.elevation_m.shape[0]
    assert found.ground.spacing_m * (rows - 1) == pytest.approx(height_m, rel=0.02)
    row, _ = peak(found)
    assert row / (rows - 1) == pytest.approx(5 / (ROWS - 1), abs=0.02)


def test_a_unit_that_is_not_that_of_the_reference_system_is_converted_or_refused(
    tmp_path: Path,
) -> None:
    axes = {axis: attributes | {"units": "km"} for axis, attributes in METRES.items()}
    y, x = (5_200_000 + NORTH_FIRST_M) / 1000, (500_000 + X_M) / 1000
    path = write(tmp_path / "a.nc", y, x, heights(), attributes=axes)
    assert read(path, crs="EPSG:32633").ground.spacing_m == pytest.approx(2.0, rel=1e-3)
    with pytest.raises(InvalidInputError, match=r"[xy] in km"):
        read(path, crs="EPSG:4326")
    lat, lon = 46 - 1e-4 * np.arange(ROWS), 7.0 + 1e-4 * np.arange(COLS)
    path = write(tmp_path / "b.nc", lat, lon, heights(), ("lat", "lon"), DEGREES)
    with pytest.raises(InvalidInputError, match="degrees_"):
        read(path, crs="EPSG:32633")


def test_a_mapping_and_transposed_dimensions(tmp_path: Path) -> None:
    lat, lon = np.linspace(46.01, 46.0, ROWS), np.linspace(7.4, 7.41, COLS)
    wgs84 = {
        "grid_mapping_name": "latitude_longitude",
        "semi_major_axis": 6378137.0,
        "inverse_flattening": 298.257223563,
    }
    path = write(tmp_path / "a.nc", lat, lon, heights(), ("lat", "lon"), DEGREES, wgs84)
    found = read(path)
    assert found.georeference is not None
    rows, cols = found.ground.elevation_m.shape
    row, col = peak(found)
    shares = (row / (rows - 1), col / (cols - 1))
    assert shares == pytest.approx((5 / (ROWS - 1), 8 / (COLS - 1)), abs=0.03)
    turned = write(tmp_path / "b.nc", lat, lon, heights().T, ("lon", "lat"), DEGREES, wgs84)
    with pytest.raises(InvalidInputError, match=r"dimensions \(lon, lat\)"):
        read(turned)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_uneven_steps_are_refused(axis: str, tmp_path: Path) -> None:
    mercator_deg = np.degrees(np.arctan(np.sinh(np.radians(np.linspace(80, 60, ROWS)))))
    y, x = NORTH_FIRST_M.copy(), X_M.copy()
    if axis == "y":
        y = mercator_deg
    else:
        x[20:] += 1
    path = write(tmp_path / "a.nc", y, x, heights())
    for keys in ({}, {"spacing_m": 2.0}, {"crs": "EPSG:4326"}):
        with pytest.raises(InvalidInputError, match="even steps"):
            read(path, **keys)


def test_rounded_coordinates_are_even(tmp_path: Path) -> None:
    lat, lon = 46 - np.arange(ROWS) / 3600, 7 + np.arange(COLS) / 3600
    path = write(
        tmp_path / "a.nc",
        lat.astype("f4"),
        lon.astype("f4"),
        heights(),
        ("lat", "lon"),
        DEGREES,
    )
    assert read(path, crs="EPSG:4326").holes == 0


@pytest.mark.parametrize("dims", [("row", "col"), ("y", "col")])
def test_dimensions_that_say_nothing_are_refused(dims: tuple[str, str], tmp_path: Path) -> None:
    path = write(tmp_path / "a.nc", NORTH_FIRST_M, X_M, heights(), dims)
    with pytest.raises(InvalidInputError, match="coordinate variable"):
        read(path, spacing_m=2.0)


@pytest.mark.parametrize(
    ("attributes", "voids"),
    [
        ({"valid_min": 0}, ("low",)),
        ({"valid_max": 9000}, ("high",)),
        ({"valid_min": 0, "valid_max": 9000}, ("low", "high")),
        ({"valid_range": [0, 9000]}, ("low", "high")),
        ({"missing_value": -5}, ("low",)),
        ({"_FillValue": -5, "missing_value": 9500}, ("low", "high")),
    ],
)
@pytest.mark.parametrize("dtype", ["f4", "i2"])
def test_each_attribute_of_voids_counts(
    attributes: dict[str, Any], voids: tuple[str, ...], dtype: str, tmp_path: Path
) -> None:
    z = heights().astype(dtype)
    z[20:23, 20:25] = -5
    z[30:32, 5:7] = 9500
    typed: dict[str, Any] = {name: np.asarray(value, dtype) for name, value in attributes.items()}
    path = write(tmp_path / "a.nc", NORTH_FIRST_M, X_M, z, attributes=METRES, **typed)
    found = read(path, nodata="none")
    assert found.filled_px == sum({"low": 15, "high": 4}[name] for name in voids)


def test_valid_values_are_those_of_packed_ones(tmp_path: Path) -> None:
    packed = np.rint((heights() - 300) * 100).astype("i2")
    packed[20:23, 20:25] = -50
    scales: dict[str, Any] = {"scale_factor": np.float64(0.01), "add_offset": np.float64(300)}
    path = write(
        tmp_path / "a.nc",
        NORTH_FIRST_M,
        X_M,
        packed,
        attributes=METRES,
        valid_min=np.int16(0),
        **scales,
    )
    assert read(path).filled_px == 15
    path = write(
        tmp_path / "b.nc",
        NORTH_FIRST_M,
        X_M,
        packed,
        attributes=METRES,
        valid_min=np.float64(300),
        **scales,
    )
    with pytest.raises(InvalidInputError, match="packed"):
        read(path)


@pytest.mark.parametrize(
    "says", [{"positive": "down"}, {"standard_name": "sea_floor_depth_below_geoid"}]
)
def test_depths_are_refused_until_they_are_turned(says: dict[str, Any], tmp_path: Path) -> None:
    path = write(tmp_path / "a.nc", NORTH_FIRST_M, X_M, heights(), attributes=METRES, **says)
    with pytest.raises(InvalidInputError, match="depths"):
        read(path)
    assert read(path, scale=-1.0).ground.elevation_m.max() == pytest.approx(-300, abs=0.1)


def test_each_time_is_a_band_with_its_own_rows(tmp_path: Path) -> None:
    z = np.stack([heights() + 100, heights()[:, ::-1], heights()])[:, ::-1]
    path = write(
        tmp_path / "a.nc", NORTH_FIRST_M[::-1], X_M, z, ("time", "y", "x"), attributes=METRES
    )
    assert peak(read(path, band=2)) == (5, COLS - 1 - 8)
    assert read(path).ground.elevation_m.min() > 399


def test_attributes_that_replace_what_a_variable_is_are_refused(tmp_path: Path) -> None:
    for name in ("dimensions", "data", "shape"):
        other = f"{name[:-1]}Q"
        axes = {axis: each | {other: "yx"} for axis, each in METRES.items()}
        values: dict[str, Any] = {other: np.arange(3.0)}
        path = write(
            tmp_path / f"{name}.nc", NORTH_FIRST_M, X_M, heights(), attributes=axes, **values
        )
        path.write_bytes(path.read_bytes().replace(other.encode(), name.encode()))
        read_or_refuse(path)


def test_damaged_files_are_refused_or_read(tmp_path: Path) -> None:
    whole = write(
        tmp_path / "a.nc", NORTH_FIRST_M, X_M, heights(), attributes=METRES, valid_min=np.float32(0)
    ).read_bytes()
    random = np.random.default_rng(0)
    for number in range(150):
        data = bytearray(whole)
        for place in random.integers(4, 900, 3):
            data[place] = random.integers(256)
        path = tmp_path / "b.nc"
        path.write_bytes(bytes(data) if number % 3 else bytes(data[: random.integers(len(data))]))
        read_or_refuse(path)


def read_or_refuse(path: Path) -> None:
    with suppress(InvalidInputError):
        read(path, spacing_m=2.0)


def test_what_gdal_writes_is_where_gdal_has_it(tmp_path: Path) -> None:
    shape = {"width": COLS, "height": ROWS, "count": 1, "dtype": "float32"}
    place = from_origin(500_000, 5_200_000, 2, 2)
    tiff, path = tmp_path / "utm.tif", tmp_path / "utm.nc"
    with rasterio.open(
        tiff, "w", driver="GTiff", crs="EPSG:32633", transform=place, **shape
    ) as file:
        file.write(heights(), 1)
    rasterio.shutil.copy(tiff, path, driver="netCDF")
    found = read(path)
    assert peak(found) == (5, 8)
    assert found.georeference is not None
    assert found.georeference.map_to_system[2] == pytest.approx(500_000 + COLS, abs=0.01)
    assert found.georeference.map_to_system[5] == pytest.approx(5_200_000 - ROWS, abs=0.01)
