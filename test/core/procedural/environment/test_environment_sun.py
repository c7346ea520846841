"""The sun's position against published values and an independent library."""

from datetime import datetime, timedelta, timezone
from math import degrees, radians

import numpy as np
import pytest
from astral import Observer
from astral import sun as astral_sun
from pydantic import ValidationError

from oaisys_core.config.sections.environment import SunFromTimeConfig
from oaisys_core.procedural.environment.sun import azimuth_in_map, sun_position

UTC = timezone.utc  # noqa: UP017 - as in Python 3.10


def seen_deg(when: datetime, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Elevation and azimuth on a compass."""
    position = sun_position(when, latitude_deg, longitude_deg)
    return degrees(position.elevation_rad), degrees(position.azimuth_rad)


def test_the_worked_example_of_nrels_algorithm() -> None:
    """Reda and Andreas (2004), appendix A.5: zenith 50.11162, azimuth 194.34024 degrees."""
    when = datetime(2003, 10, 17, 12, 30, 30, tzinfo=timezone(timedelta(hours=-7)))
    elevation_deg, azimuth_deg = seen_deg(when, 39.742476, -105.1786)
    assert elevation_deg == pytest.approx(90 - 50.11162, abs=0.01)
    assert azimuth_deg == pytest.approx(194.34024, abs=0.01)


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


@pytest.mark.parametrize(
    ("compass_deg", "offset_deg", "map_deg"),
    [(0, 0, 90), (90, 0, 0), (180, 0, -90), (270, 0, -180), (90, 30, 30), (0, -90, 0)],
)
def test_azimuths_turn_from_east_towards_north(
    compass_deg: float, offset_deg: float, map_deg: float
) -> None:
    azimuth = azimuth_in_map(radians(compass_deg), radians(offset_deg))
    assert degrees(azimuth) == pytest.approx(map_deg)


def test_a_time_without_its_offset_is_refused() -> None:
    with pytest.raises(ValueError, match="offset from UTC"):
        sun_position(datetime(2024, 1, 1), 0.0, 0.0)  # noqa: DTZ001 - the point of the test
    with pytest.raises(ValidationError, match="timezone"):
        SunFromTimeConfig.model_validate(
            {"date_time": "2024-01-01T12:00:00", "latitude_deg": 0, "longitude_deg": 0}
        )
