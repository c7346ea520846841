"""Places of grounds, against heights that say where they are."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Geod, Transformer
from rasterio.control import GroundControlPoint
from rasterio.windows import Window
from scipy.ndimage import map_coordinates
from synthetic_worlds import SMALL_MATERIALS
from typer.testing import CliRunner

from oaisys_core.cli.main import app
from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.stage import DemConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import places
from oaisys_core.procedural.terrain.dem import ImportedGround, import_dem
from oaisys_core.simulation import Simulation
from oaisys_core.types.georeference import Georeference

MOON = "+proj=stere +lat_0=-90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m"
MARS = "+proj=eqc +lat_ts=0 +lon_0=0 +R=3396190 +units=m"


def _turned(angle_deg: float, a: float, e: float, c: float, f: float) -> Affine:
    """Pixels of a by e whose columns go by an angle from x towards y."""
    return Affine.translation(c, f) @ Affine.rotation(angle_deg) @ Affine.scale(a, e)


FILES: dict[str, tuple[str, Affine]] = {
    "UTM": ("EPSG:32633", Affine(2.0, 0, 412_000.0, 0, -2.0, 5_322_000.0)),
    "degrees": ("EPSG:4326", Affine(1e-5, 0, 11.0, 0, -1e-5, 46.5)),
    "Mercator": ("EPSG:3857", Affine(3.0, 0, 1_250_000.0, 0, -3.0, 6_100_000.0)),
    "lunar pole": (MOON, Affine(20.0, 0, 90_000.0, 0, -20.0, -60_000.0)),
    "Mars": (MARS, Affine(18.0, 0, 8_140_000.0, 0, -18.0, 1_080_000.0)),
    "upwards": ("EPSG:32719", Affine(5.0, 0, 350_000.0, 0, 5.0, 7_300_000.0)),
    "turned": ("EPSG:32633", _turned(33.0, 2.0, -2.0, 412_000.0, 5_322_000.0)),
    "turned by 160": ("EPSG:32633", _turned(160.0, 2.0, -3.0, 412_000.0, 5_322_000.0)),
    "turned and mirrored": ("EPSG:32633", _turned(-70.0, -2.0, -2.0, 412_000.0, 5_322_000.0)),
    "turned lunar pole": (MOON, _turned(-90.0, 20.0, -20.0, 90_000.0, -60_000.0)),
    "turned degrees": ("EPSG:4326", _turned(20.0, 1e-5, -1e-5, 11.0, 46.5)),
}
SIZE = 101


def write(path: Path, crs: str, transform: Affine, *, bend_px: float = -1.0) -> tuple[float, float]:
    """A file whose heights are metres to the east of its middle plus twice those to the north.

    With a bend of 0 or more its place is said by control points alone, and columns are moved by
    so many pixels in the middle rows: a parabola.

    Returns the longitude and latitude of the middle.
    """
    system = CRS.from_user_input(crs)
    to_degrees = Transformer.from_crs(system, system.geodetic_crs, always_xy=True)
    columns, rows = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    bend = max(bend_px, 0.0)
    at = _at(transform, columns + bend * _parabola(rows), rows)
    lon, lat = to_degrees.transform(*at)
    middle = (float(lon[SIZE // 2, SIZE // 2]), float(lat[SIZE // 2, SIZE // 2]))
    geod = system.get_geod()
    assert geod is not None
    heights = _height(geod, middle, lon, lat)
    profile: dict[str, Any] = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": crs}
    shape: dict[str, Any] = {"width": SIZE, "height": SIZE, "transform": transform}
    if bend_px >= 0:
        del profile["crs"], shape["transform"]
        ends = np.linspace(0, SIZE, 4)
        shape["gcps"] = [
            GroundControlPoint(row, col, *_at(transform, col + bend * _parabola(row), row))
            for row in ends
            for col in ends
        ]
        shape["crs"] = crs
    with rasterio.open(path, "w", **profile, **shape) as file:
        file.write(heights.astype(np.float32), 1)
    return middle


def _at(transform: Affine, column: Any, row: Any) -> tuple[Any, Any]:
    a, b, c, d, e, f, *_ = transform
    return a * column + b * row + c, d * column + e * row + f


def _parabola(row: Any) -> Any:
    """0 at the first and the last row, 1 in the middle."""
    return 4 * row * (SIZE - row) / SIZE**2


def _height(geod: Geod, middle: tuple[float, float], lon: Any, lat: Any) -> Any:
    azimuth_deg, _, distance_m = geod.inv(
        np.full_like(lon, middle[0]), np.full_like(lat, middle[1]), lon, lat
    )
    east_m, north_m = (distance_m * turn(np.radians(azimuth_deg)) for turn in (np.sin, np.cos))
    return 0.1 * east_m + 0.2 * north_m


def imported(path: Path, **values: Any) -> ImportedGround:
    return import_dem(DemConfig(file=path, **values))


BENDS = {"control points": 0.0, "bent control points": 3.0}


@pytest.mark.parametrize("name", [*FILES, *BENDS])
def test_places_are_where_the_heights_say(tmp_path: Path, name: str) -> None:
    """Heights tell east and north of the middle, so each point of the ground tells its place."""
    crs, transform = FILES[name if name in FILES else "turned"]
    middle = write(tmp_path / "a.tif", crs, transform, bend_px=BENDS.get(name, -1.0))
    found = imported(tmp_path / "a.tif", position_m=(30.0, -20.0, 5.0), offset_m=7.0)
    place = found.georeference
    assert place is not None
    geod = CRS.from_user_input(crs).get_geod()
    assert geod is not None
    x0, y0, x1, y1 = found.ground.extent_m
    rng = np.random.default_rng(1)
    # At the rim of a bent image there is nothing.
    rim_m = found.ground.spacing_m * (4 if name == "bent control points" else 0)
    xy_m = rng.uniform((x0 + rim_m, y0 + rim_m), (x1 - rim_m, y1 - rim_m), (1000, 2))
    column, row = ((xy_m - (x0, y0)) / found.ground.spacing_m).T
    z_m = map_coordinates(found.ground.elevation_m.astype(np.float64), (row, column), order=1)
    lon, lat, elevation_m = places.lon_lat_height(place, np.column_stack((xy_m, z_m))).T
    step_m = found.ground.spacing_m
    np.testing.assert_allclose(elevation_m, _height(geod, middle, lon, lat), atol=0.02 * step_m)
    np.testing.assert_allclose(elevation_m, z_m - 12.0, atol=1e-9)


@pytest.mark.parametrize("name", FILES)
def test_points_come_back_within_a_millimetre(tmp_path: Path, name: str) -> None:
    write(tmp_path / "a.tif", *FILES[name])
    found = imported(tmp_path / "a.tif")
    place = found.georeference
    assert place is not None
    x0, y0, x1, y1 = found.ground.extent_m
    points_m = np.random.default_rng(2).uniform((x0, y0, -50), (x1, y1, 50), (1000, 3))
    again_m = places.points_in_map(place, places.lon_lat_height(place, points_m))
    assert np.abs(again_m - points_m).max() < 1e-3


def georeference_at(crs: str, x: float, y: float) -> Georeference:
    return Georeference(CRS.from_user_input(crs).to_wkt(), (1, 0, x, 0, 1, y), 0.0)


SWISS = georeference_at("EPSG:2056", 2_600_000, 1_200_000)
UTM = georeference_at("EPSG:32632", 500_000, 5_200_000)
MERCATOR = georeference_at("EPSG:3857", 20_037_000, 0)
DEGREES = georeference_at("EPSG:4326", 11, 46)


@pytest.mark.parametrize("place", [(-171, -47), (180, 0), (0, -90), (99, 0), (100, 10)])
def test_places_that_a_projection_puts_where_others_are_are_refused(
    place: tuple[float, float],
) -> None:
    """The antipode of Berne was 9 km from Berne."""
    with pytest.raises(InvalidInputError, match=f"place: received '{place[0]}, {place[1]}'"):
        places.points_in_map(SWISS, [(8.0, 47.0, 0.0), (*place, 0.0)])


@pytest.mark.parametrize("place", [(0, 90), (-180, 0), (369, 47), (-351, 47), (9, -47)])
def test_places_far_away_are_those_that_they_are(place: tuple[float, float]) -> None:
    (point_m,) = places.points_in_map(UTM, [(*place, 5.0)])
    ((lon, lat, _),) = places.places_of(UTM, [point_m])
    assert lat == pytest.approx(place[1], abs=1e-6)
    if abs(place[1]) < 90:
        assert (lon - place[0] + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("georeference", "x_m"),
    [(SWISS, 2.5e7), (SWISS, 1e300), (UTM, 2.5e7), (UTM, 1e9), (DEGREES, 1e7), (MERCATOR, 1e300)],
)
def test_points_without_a_place_are_refused(georeference: Georeference, x_m: float) -> None:
    with pytest.raises(InvalidInputError, match=r"point: received .* in the area of the stage's"):
        places.places_of(georeference, [(0.0, 0.0, 0.0), (x_m, 0.0, 0.0)])


def test_a_stage_may_lie_across_the_longitude_of_180() -> None:
    found = places.places_of(MERCATOR, [(0, 0, 0), (2_000, 0, 0)])
    lon = np.degrees(np.array((20_037_000, 20_039_000)) / 6_378_137)
    np.testing.assert_allclose(found[:, 0], (lon[0], lon[1] - 360), atol=1e-9)


def test_north_of_a_polar_map_is_not_up(tmp_path: Path) -> None:
    """Towards +y on a map of the south pole with 0° up, east of it by 56.3°."""
    write(tmp_path / "a.tif", *FILES["lunar pole"])
    place = imported(tmp_path / "a.tif").georeference
    assert place is not None
    x, y = 91_010.0, -61_010.0
    # North is away from the pole: along (x, y) itself; azimuths are clockwise.
    expected_deg = np.degrees(np.arctan2(0, 1) - np.arctan2(x, y))
    found_deg = (places.north_deg(place) - expected_deg + 180) % 360 - 180
    assert abs(found_deg) < 0.05


def test_files_without_a_place_have_none(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    write(path, *FILES["UTM"])
    assert imported(path, spacing_m=1.0).georeference is None


@pytest.mark.parametrize("crs", ["EPSG:32633", "EPSG:4326", MOON])
def test_a_system_without_pixels_in_it_needs_the_distance_between_them(
    tmp_path: Path, crs: str
) -> None:
    """The commands ended with a failed assertion."""
    path = tmp_path / "a.tif"
    write(path, crs, Affine.identity())
    refused = r"dem\.spacing_m: received None, expected the distance .* a\.tif does not define it"
    with pytest.raises(InvalidInputError, match=refused):
        imported(path)
    result = CliRunner().invoke(app, ["place", "info", str(path)])
    assert isinstance(result.exception, InvalidInputError)
    ground = imported(path, spacing_m=2.0)
    assert (ground.ground.spacing_m, ground.georeference) == (2.0, None)


def test_batches_tell_their_place(tmp_path: Path) -> None:
    write(tmp_path / "a.tif", *FILES["UTM"])
    stage = {"dem": {"file": str(tmp_path / "a.tif")}, "surroundings": "plain"}
    sections = {"stage": stage, "materials": SMALL_MATERIALS, "assets": {"rocks": []}}
    config = config_from_mapping({"backend": "analytic", **sections})
    simulation = Simulation(config)
    simulation.step_batch()
    place = simulation.info().georeference
    assert place is not None
    assert places.system_of(place.wkt).to_epsg() == 32633


def test_the_sun_of_a_time_stands_over_the_place_of_the_model(tmp_path: Path) -> None:
    """North at longitude L of this map is (sin L, cos L), so compass azimuths turn by L."""
    lon, lat = write(tmp_path / "a.tif", *FILES["lunar pole"])
    when = {"date_time": "2026-01-28T00:00:00Z"}
    own = {**when, "latitude_deg": lat, "longitude_deg": lon, "north_offset_deg": 0.0}
    skies = []
    for sun, stage in (
        (when, {"dem": {"file": str(tmp_path / "a.tif")}, "surroundings": "plain"}),
        (own, {"preset": "plane", "resolution_px": 9}),
    ):
        simulation = Simulation(
            config_from_mapping(
                {
                    "backend": "analytic",
                    "stage": {**stage, "body": "moon"},
                    "materials": SMALL_MATERIALS,
                    "assets": {"rocks": []},
                    "environment": {"sky": {"model": "none"}, "sun_from_time": sun},
                }
            )
        )
        simulation.step_batch()
        skies.append(simulation.scene.sky)
    on_tile, by_compass = skies
    assert on_tile.sun_elevation_rad == pytest.approx(by_compass.sun_elevation_rad, abs=1e-6)
    turn = on_tile.sun_azimuth_rad - by_compass.sun_azimuth_rad + np.radians(lon)
    assert abs(np.angle(np.exp(1j * turn))) < 1e-5


def test_the_command_says_where_a_model_lies(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    lon, lat = write(path, *FILES["UTM"])
    said = CliRunner().invoke(
        app, ["place", "info", str(path), "--to-map", f"{lon},{lat}", "--from-map", "10,20,30"]
    )
    assert said.exit_code == 0, said.output
    assert "WGS 84 / UTM zone 33N" in said.output
    assert f"{lon},{lat}  is  0.0000, 0.0000" in said.output.replace("-0.0000", "0.0000")
    at = CliRunner().invoke(app, ["place", "info", str(path), "--at", "2026-06-21T11:00:00Z"])
    assert at.exit_code == 0, at.output
    assert "sun               elevation" in at.output
    wrong = CliRunner().invoke(app, ["place", "info", str(path), "--to-map", "north"])
    assert wrong.exit_code != 0


def test_a_warped_file_is_told_by_its_projection(tmp_path: Path) -> None:
    path = tmp_path / "wide.tif"
    write(path, "EPSG:4326", Affine(1e-3, 0, 11.0, 0, -1e-3, 46.5))
    said = CliRunner().invoke(app, ["place", "info", str(path)])
    assert said.exit_code == 0, said.output
    assert "Azimuthal Equidistant around the middle of the file" in said.output
    (corner,) = re.findall(r"south-west +(.*)", said.output)
    assert "elevation" not in corner, "the ground is not at z = 0 there"


def _grid(**header: str) -> bytes:
    whole = {"ncols": "2", "nrows": "2", "xllcorner": "0", "yllcorner": "0", "cellsize": "1"}
    lines = [f"{key} {value}" for key, value in {**whole, **header}.items()]
    return "\n".join([*lines, "1 2", "3 4", ""]).encode()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("empty.tif", b"", "stage.dem.file: received"),
        ("empty.tif", b"", "it is empty"),
        ("array.npz", b"PK\x03\x04 an archive", "writes an array as a GeoTIFF"),
        ("nan.asc", _grid(xllcorner="nan", cellsize="1e400"), "finite"),
        ("no_file.tif", None, "existing file"),
        ("pipe.tif", "pipe", "no pipe"),
        ("device.tif", "device", "no device"),
    ],
)
def test_the_command_refuses_what_is_no_elevation_model_in_a_sentence(
    tmp_path: Path, name: str, content: bytes | str | None, said: str
) -> None:
    file = tmp_path / name
    if content == "pipe":
        os.mkfifo(file)
    elif content == "device":
        file.symlink_to("/dev/zero")
    elif isinstance(content, bytes):
        file.write_bytes(content)
    result = CliRunner().invoke(app, ["place", "info", str(file)])
    assert isinstance(result.exception, InvalidInputError)
    assert said in str(result.exception)


def test_turned_files_tell_their_north_and_need_a_body(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    write(path, *FILES["turned"])
    said = CliRunner().invoke(app, ["place", "info", str(path)])
    assert said.exit_code == 0, said.output
    # 33 degrees to the left of grid north, which differs from true north by the convergence.
    north_deg = float(said.output.split("+y points to")[1].split("°")[0])
    assert north_deg == pytest.approx(-33.0, abs=1.0)
    for values in ({"spacing_m": 2.0}, {"crs": 'LOCAL_CS["here",UNIT["metre",1]]'}):
        with pytest.raises(InvalidInputError, match="rows from west to east"):
            imported(path, **values)


@pytest.mark.parametrize("columns", [(0.0, 50.0), (0.0, 50.0, 90.0)])
def test_control_points_in_a_line_are_refused(tmp_path: Path, columns: tuple[float, ...]) -> None:
    path = tmp_path / "a.tif"
    points = [GroundControlPoint(2 * c, c, 412_000 + c, 5_322_000 + c) for c in columns]
    profile: dict[str, Any] = {"driver": "GTiff", "dtype": "float32", "count": 1}
    with rasterio.open(
        path, "w", width=9, height=9, gcps=points, crs="EPSG:32633", **profile
    ) as file:
        file.write(np.ones((9, 9), np.float32), 1)
    with pytest.raises(InvalidInputError, match="at least 3, not in a line"):
        imported(path)


def test_a_window_of_a_large_file_is_read_alone(tmp_path: Path) -> None:
    """100 km at 5 m, of which but the pixels of the window are stored at all."""
    path, side, first = tmp_path / "large.tif", 20_000, (12_000, 7_000)
    place = Affine(5.0, 0, 400_000.0, 0, -5.0, 5_300_000.0)
    columns, rows = np.meshgrid(np.arange(512) + 0.5, np.arange(512) + 0.5)
    x, y = _at(place, columns + first[0], rows + first[1])
    profile: dict[str, Any] = {"driver": "GTiff", "dtype": "float32", "count": 1, "nodata": -1.0}
    tiles = {"tiled": True, "blockxsize": 256, "blockysize": 256, "SPARSE_OK": True}
    with rasterio.open(
        path, "w", width=side, height=side, transform=place, crs="EPSG:32633", **profile, **tiles
    ) as file:
        heights = 0.1 * (x - 460_000) + 0.02 * (y - 5_265_000) + 900
        file.write(heights.astype(np.float32), 1, window=Window(*first, 512, 512))
    to_degrees = Transformer.from_crs("EPSG:32633", "EPSG:4326", always_xy=True)
    middle = to_degrees.transform(461_280.0, 5_263_720.0)
    window = {"size_m": (1200.0, 800.0), "centre_lon_lat_deg": middle}

    found = imported(path, window=window)
    place_found = found.georeference
    assert place_found is not None
    x0, y0, x1, y1 = found.ground.extent_m
    assert (x1 - x0, y1 - y0) == pytest.approx((1200.0, 800.0), abs=10.0)
    elevation_m = found.ground.elevation_m
    corners_m = [(x0, y0, elevation_m[0, 0]), (x1, y1, elevation_m[-1, -1])]
    lon, lat, height_m = places.lon_lat_height(place_found, corners_m).T
    x, y = to_degrees.transform(lon, lat, direction="INVERSE")
    np.testing.assert_allclose(
        height_m, 0.1 * (x - 460_000) + 0.02 * (y - 5_265_000) + 900, atol=1e-3
    )

    with pytest.raises(InvalidInputError, match="at most 100000000 pixels, not 20000 x 20000"):
        imported(path)
    with pytest.raises(InvalidInputError, match="a window inside of the file, of 20000 columns"):
        imported(path, window={**window, "size_m": (80_000.0, 800.0)})
    with pytest.raises(InvalidInputError, match="of at most 100000000 pixels"):
        imported(path, window={"size_m": (60_000.0, 60_000.0)})
    with pytest.raises(InvalidInputError, match="no reference system of a body"):
        imported(path, window=window, crs='LOCAL_CS["here",UNIT["metre",1]]')


def test_windows_need_a_geotiff_and_its_own_pixels(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("no raster")
    with pytest.raises(InvalidInputError, match=r"stage\.dem\.file"):
        imported(path, window={"size_m": (10.0, 10.0)})
    with pytest.raises(ValueError, match="no spacing_m or size_m"):
        imported(path, window={"size_m": (10.0, 10.0)}, spacing_m=1.0)
