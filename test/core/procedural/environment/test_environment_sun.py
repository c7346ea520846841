"""The sun's position against published values and an independent library."""

import sys
from datetime import datetime, timedelta, timezone
from math import degrees, radians

import numpy as np
import pyproj
import pytest
from astral import Observer
from astral import sun as astral_sun
from pydantic import ValidationError

from oaisys_core.config.sections.sun import SunFromTimeConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.environment import ephemeris
from oaisys_core.procedural.environment.ephemeris import Target
from oaisys_core.procedural.environment.sun import sun_from_earth_km
from oaisys_core.procedural.environment.sun_in_map import (
    SeenBody,
    axes_of_place,
    map_axes,
    sight_over,
    sun_at,
)
from oaisys_core.types import Georeference

UTC = timezone.utc  # noqa: UP017 - as in Python 3.10


def place(latitude_deg: float, longitude_deg: float) -> SunFromTimeConfig:
    return SunFromTimeConfig(
        date_time=datetime(2024, 1, 1, tzinfo=UTC),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
    )


def on_compass(seen: SeenBody) -> tuple[float, float]:
    """Elevation, and azimuth clockwise from true north, where +y points there."""
    return degrees(seen.elevation_rad), (90 - degrees(seen.azimuth_rad)) % 360


def seen_deg(when: datetime, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Elevation and azimuth on a compass."""
    return on_compass(sun_at(place(latitude_deg, longitude_deg), when, "earth", None))


def test_the_worked_example_of_nrels_algorithm() -> None:
    """Reda and Andreas (2004), appendix A.5: zenith 50.11162, azimuth 194.34024 degrees."""
    when = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    seen = sun_at(place(39.742476, -105.1786), when, "earth", None)
    elevation_deg, azimuth_deg = on_compass(seen)
    assert elevation_deg == pytest.approx(90 - 50.11162, abs=0.01)
    assert azimuth_deg == pytest.approx(194.34024, abs=0.01)
    assert seen.distance_au == pytest.approx(0.9965422974, abs=5e-5)


@pytest.mark.parametrize(
    ("when", "declination_deg"),
    [
        (datetime(2024, 3, 20, 3, 6, tzinfo=UTC), 0.0),
        (datetime(2024, 6, 20, 20, 51, tzinfo=UTC), 23.4364),
        (datetime(2024, 9, 22, 12, 44, tzinfo=UTC), 0.0),
        (datetime(2024, 12, 21, 9, 20, tzinfo=UTC), -23.4363),
    ],
)
def test_equinoxes_and_solstices(when: datetime, declination_deg: float) -> None:
    """Their published times; from the north pole the sun's elevation is its declination."""
    elevation_deg, _ = seen_deg(when, 90.0, 0.0)
    # Refraction is half a degree at the horizon and 0.04 degrees at 23.
    lift_deg = 0.49 if declination_deg == 0 else 0.04
    if declination_deg >= 0:
        assert elevation_deg == pytest.approx(declination_deg + lift_deg, abs=0.03)
    else:
        assert elevation_deg == pytest.approx(declination_deg, abs=0.01)


def test_it_agrees_with_astral_all_over_the_earth() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        when = datetime(1990, 1, 1, tzinfo=UTC) + timedelta(days=float(rng.uniform(0, 16000)))
        latitude_deg, longitude_deg = float(rng.uniform(-80, 80)), float(rng.uniform(-180, 180))
        observer = Observer(latitude_deg, longitude_deg)
        elevation_deg, azimuth_deg = seen_deg(when, latitude_deg, longitude_deg)
        if elevation_deg > 0:
            assert elevation_deg == pytest.approx(astral_sun.elevation(observer, when), abs=0.1)
        apart = (azimuth_deg - astral_sun.azimuth(observer, when) + 180) % 360 - 180
        assert abs(apart) * np.cos(radians(elevation_deg)) < 0.05


def test_on_earth_it_is_that_of_the_ephemeris() -> None:
    """Skyfield's own sun over Earth, of another theory, within 0.01 degrees and 1e-4 au."""
    framelib = pytest.importorskip("skyfield.framelib", exc_type=ModuleNotFoundError)
    bodies, timescale = ephemeris._de421()
    rng = np.random.default_rng(2)
    for days in rng.uniform(0, 20000, 40):
        when = datetime(1990, 1, 1, tzinfo=UTC) + timedelta(days=float(days))
        time = timescale.from_datetime(when)
        sun = bodies["earth"].at(time).observe(bodies["sun"]).apparent()
        known = sun.frame_xyz(framelib.itrs).km
        found = sun_from_earth_km(when)
        lengths = np.linalg.norm(known), np.linalg.norm(found)
        assert lengths[1] / lengths[0] == pytest.approx(1, abs=1e-4)
        assert degrees(np.linalg.norm(known / lengths[0] - found / lengths[1])) < 0.01


HORIZONS_MOON = [
    ((2024, 6, 1, 0), 271.364365, -17.730340, 1.01331236894816),
    ((2024, 6, 1, 6), 271.393978, -20.786094, 1.01321803258123),
    ((2024, 6, 15, 0), 88.497638, 9.077305, 1.01614798699260),
    ((2024, 6, 15, 12), 88.458421, 15.182862, 1.01644033901335),
    ((2025, 3, 14, 5), 91.340080, 86.190938, 0.99684341030154),
]
"""NASA/JPL Horizons (DE441, MEAN_ME axes): time, azimuth, elevation and distance of the sun's
centre at longitude 0 and latitude 0 of the Moon, without air."""


@pytest.mark.parametrize(("when", "azimuth_deg", "elevation_deg", "distance_au"), HORIZONS_MOON)
def test_the_sun_of_the_moon_is_that_of_horizons(
    when: tuple[int, int, int, int], azimuth_deg: float, elevation_deg: float, distance_au: float
) -> None:
    seen = sun_at(place(0.0, 0.0), datetime(*when, tzinfo=UTC), "moon", None)
    found = on_compass(seen)
    assert found[0] == pytest.approx(elevation_deg, abs=0.005)
    aside = (found[1] - azimuth_deg) * np.cos(radians(elevation_deg))
    assert abs(aside) < 0.005
    assert seen.distance_au == pytest.approx(distance_au, rel=1e-7)


def test_discs_are_as_large_as_in_horizons() -> None:
    """1924.537 and 6585.038 seconds of arc, 2025-03-14 05:00 at the middle of the near side."""
    when, axes = datetime(2025, 3, 14, 5, tzinfo=UTC), axes_of_place(0.0, 0.0, 0.0)
    sun, earth = (sight_over(axes, "moon", target, when) for target in ("sun", "earth"))
    assert degrees(sun.angular_diameter_rad) * 3600 == pytest.approx(1924.537, abs=0.02)
    assert degrees(earth.angular_diameter_rad) * 3600 == pytest.approx(6585.038, abs=0.5)


@pytest.mark.parametrize(
    ("target", "longitude_deg", "latitude_deg"),
    [("sun", -55.867, -1.554), ("earth", 0.041, -4.685)],
)
def test_sun_and_earth_are_above_their_published_points_of_the_moon(
    target: Target, longitude_deg: float, latitude_deg: float
) -> None:
    """NASA's Scientific Visualization Studio, Moon phase and libration 2024, 1 January 00:00."""
    axes = axes_of_place(longitude_deg, latitude_deg, 0.0)
    seen = sight_over(axes, "moon", target, datetime(2024, 1, 1, tzinfo=UTC))
    assert degrees(seen.elevation_rad) > 90 - 0.006


HORIZONS_JEZERO = [
    (0, -39.131322),
    (6, -41.383649),
    (10, 12.205060),
    (12, 39.816349),
    (15, 76.210730),
    (18, 51.365416),
    (21, 10.141850),
]
"""NASA/JPL Horizons: hour of 2026-08-23 and elevation of Earth at 77.4508 E and planetographic
18.6320 N on Mars."""


@pytest.mark.parametrize(("hour", "elevation_deg"), HORIZONS_JEZERO)
def test_the_sky_of_mars_is_that_of_horizons(hour: int, elevation_deg: float) -> None:
    axes = axes_of_place(77.4508, 18.6320, 0.0)
    seen = sight_over(axes, "mars", "earth", datetime(2026, 8, 23, hour, tzinfo=UTC))
    assert degrees(seen.elevation_rad) == pytest.approx(elevation_deg, abs=0.002)


def test_the_sun_is_above_naifs_point_of_mars() -> None:
    """The sun's planetocentric place in the manual of SPICE's `subslr` (example 1, 2008-08-11).

    It is at the time that light left Mars which reached Earth at 00:00.
    """
    bodies, timescale = ephemeris._de421()
    received = datetime(2008, 8, 11, tzinfo=UTC)
    seen = bodies["earth"].at(timescale.from_datetime(received)).observe(bodies["mars"])
    when = received - timedelta(days=float(seen.light_time))
    axes = axes_of_place(-175.810721536, 23.420819946, 0.0)
    assert degrees(sight_over(axes, "mars", "sun", when).elevation_rad) > 90 - 0.01


def test_what_is_not_covered_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    late = datetime(2053, 6, 1, tzinfo=UTC)
    with pytest.raises(InvalidInputError, match=r"date_time: received '2053-06-01.*1900 to 2052"):
        sun_at(place(0.0, 0.0), late, "moon", None)
    with pytest.raises(InvalidInputError, match=r"Moon or Mars \(stage.body\)"):
        sun_at(place(0.0, 0.0), late, 2.6e6, None)
    ephemeris._de421.cache_clear()
    monkeypatch.setitem(sys.modules, "skyfield_data", None)
    with pytest.raises(InvalidInputError, match=r"skyfield-data: pip install 'oaisys_core\[eph"):
        sun_at(place(0.0, 0.0), datetime(2024, 1, 1, tzinfo=UTC), "mars", None)
    ephemeris._de421.cache_clear()


NOWHERE = SunFromTimeConfig(date_time=datetime(2024, 6, 15, tzinfo=UTC))


def lunar_tile(longitude_deg: float, latitude_deg: float) -> Georeference:
    """A map around a place of the lunar south polar stereographic projection."""
    system = pyproj.CRS.from_user_input("IAU_2015:30135")
    to_system = pyproj.Transformer.from_crs(system.geodetic_crs, system, always_xy=True)
    x, y = to_system.transform(longitude_deg, latitude_deg)
    return Georeference(system.to_wkt(), (1.0, 0.0, x, 0.0, 1.0, y), 0.0)


@pytest.mark.parametrize("longitude_deg", [-120.0, 0.0, 46.0, 170.0])
def test_on_polar_maps_north_is_true(longitude_deg: float) -> None:
    """Away from the south pole of this projection, north at longitude L is (sin L, cos L)."""
    tile = lunar_tile(longitude_deg, -85.0)
    by_hand = axes_of_place(longitude_deg, -85.0, -longitude_deg)
    np.testing.assert_allclose(map_axes(NOWHERE, tile, "moon"), by_hand, atol=1e-6)
    # A place of one's own on the same map has the map's north.
    own = map_axes(place(-85.0, longitude_deg), tile, "moon")
    np.testing.assert_allclose(own, by_hand, atol=1e-6)


def test_at_the_very_pole_longitudes_still_have_directions() -> None:
    """+y points along longitude 0, towards which Earth stands."""
    axes = map_axes(NOWHERE, lunar_tile(0.0, -90.0), "moon")
    np.testing.assert_allclose(axes, [[0, 1, 0], [1, 0, 0], [0, 0, -1]], atol=1e-6)
    earth = sight_over(axes, "moon", "earth", datetime(2024, 1, 1, tzinfo=UTC))
    assert degrees(earth.azimuth_rad) == pytest.approx(90, abs=0.1)


@pytest.mark.parametrize("code", ["IAU_2015:49900", "IAU_2015:49901"])
def test_latitudes_at_the_centre_of_mars_have_the_same_vertical(code: str) -> None:
    """PROJ turns the angle at the centre into that of the vertical."""
    system = pyproj.CRS.from_user_input(code)
    to_centre = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad"
        " +step +proj=geoc +a=3396190 +b=3376200"
        " +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    latitude_deg = 18.632
    if code.endswith("00"):
        _, latitude_deg = to_centre.transform(77.4508, latitude_deg)
        assert latitude_deg == pytest.approx(18.632 - 0.202, abs=0.002)
    degrees_per_m = 1 / 59_000
    place_deg = (degrees_per_m, 0.0, 77.4508, 0.0, degrees_per_m, latitude_deg)
    axes = map_axes(NOWHERE, Georeference(system.to_wkt(), place_deg, 0.0), "mars")
    np.testing.assert_allclose(axes, axes_of_place(77.4508, 18.6320, 0.0), atol=2e-6)


def test_a_place_must_be_known() -> None:
    with pytest.raises(InvalidInputError, match=r"latitude_deg.*oaisys place info"):
        sun_at(NOWHERE, NOWHERE.date_time, "moon", None)
    with pytest.raises(ValidationError, match="or neither of them"):
        SunFromTimeConfig(date_time=NOWHERE.date_time, latitude_deg=3.0)


@pytest.mark.parametrize(("north_deg", "turn_deg"), [(0, 0), (30, 30), (-90, -90), (360, 0)])
def test_true_north_turns_the_map(north_deg: float, turn_deg: float) -> None:
    """North is counter-clockwise from +y by so much, and east is clockwise from it."""
    x, y, _ = axes_of_place(0.0, 0.0, north_deg)
    north_in_map = np.array((x[2], y[2]))
    expected = (-np.sin(radians(turn_deg)), np.cos(radians(turn_deg)))
    np.testing.assert_allclose(north_in_map, expected, atol=1e-12)


def test_a_time_without_its_offset_is_refused() -> None:
    with pytest.raises(ValueError, match="offset from UTC"):
        sun_from_earth_km(datetime(2024, 1, 1))  # noqa: DTZ001 - the point of the test
    with pytest.raises(ValidationError, match="timezone"):
        SunFromTimeConfig.model_validate(
            {"date_time": "2024-01-01T12:00:00", "latitude_deg": 0, "longitude_deg": 0}
        )
