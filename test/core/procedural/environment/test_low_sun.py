"""A low sun: hills beyond the stage stay below it, and a warning says where they cannot."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.config.sections.environment import EnvironmentConfig
from oaisys_core.procedural.environment.low_sun import lowest_sun_rad
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

AZIMUTHS_DEG = range(0, 360, 45)
POINTS = 12
"""Points on the stage from which one looks to the sun, along each side."""

WAYS, LONGEST_WAY_M = 300, 60_000.0
"""Number and greatest of the distances at which heights are compared with the way to the sun."""


def moon(preset: str = "craters", **environment: Any) -> SimulationConfig:
    return config_from_mapping(
        {
            "backend": "analytic",
            "seed": 5,
            "stage": {"preset": preset, "extent_m": 64, "resolution_px": 129, "body": "moon"},
            "materials": {"texture_size_px": 64, "mask": {"size_px": 64}},
            "assets": {"rocks": []},
            "environment": {"sky": {"model": "none"}, **environment},
            "sensors": {"cameras": [{"width_px": 64, "height_px": 48, "fx_px": 50, "fy_px": 50}]},
        }
    )


def drawn_world(config: SimulationConfig) -> Simulation:
    simulation = Simulation(config)
    simulation.step_batch()
    return simulation


def land_of(simulation: Simulation) -> NDArray[np.float32]:
    land = simulation.scene.far_ground
    assert land is not None
    return land.vertices_m


def lit_share(simulation: Simulation, elevation_deg: float, azimuth_deg: float) -> float:
    """Share of points on the stage from which no height on the way to the sun hides it."""
    stage, land = simulation.scene.ground, simulation.scene.far_ground
    assert land is not None
    x0, y0, x1, y1 = stage.extent_m
    share = (np.arange(POINTS) + 0.5) / POINTS
    x, y = np.meshgrid(x0 + share * (x1 - x0), y0 + share * (y1 - y0))
    xy_m = np.column_stack((x.ravel(), y.ravel()))
    elevation, azimuth = np.radians((elevation_deg, azimuth_deg))
    ways_m = np.geomspace(0.5, LONGEST_WAY_M, WAYS)[:, None, None]
    on_way_m = (xy_m + ways_m * (np.cos(azimuth), np.sin(azimuth))).reshape(-1, 2)
    ground_m = np.fmax(stage.height_at(on_way_m), land.height_at(on_way_m))
    ray_m = stage.height_at(xy_m) + ways_m[..., 0] * np.tan(elevation)
    hidden = (ground_m.reshape(ray_m.shape) > ray_m).any(axis=0)
    return float(1.0 - hidden.mean())


def test_a_sun_at_three_degrees_lights_most_of_a_lunar_stage() -> None:
    simulation = drawn_world(moon(sun_elevation_deg=3.0))
    shares = [lit_share(simulation, 3.0, azimuth_deg) for azimuth_deg in AZIMUTHS_DEG]
    assert min(shares) > 0.5, shares


def test_hills_are_lower_only_where_a_configuration_allows_a_low_sun() -> None:
    high, ten, low = (
        land_of(drawn_world(moon(sun_elevation_deg=deg))) for deg in (40.0, [10.0, 60.0], [4, 60])
    )
    np.testing.assert_array_equal(high, ten)
    assert high[:, 2].max() > 1.5 * low[:, 2].max()
    night = land_of(drawn_world(moon(sun_elevation_deg=[-20.0, -5.0])))
    np.testing.assert_array_equal(high, night)


def test_a_sun_that_is_set_below_the_hills_is_warned_of_once_per_change(
    caplog: pytest.LogCaptureFixture,
) -> None:
    simulation = drawn_world(moon(sun_elevation_deg=40.0))
    land = simulation.scene.far_ground
    assert land is not None
    highest = max(AZIMUTHS_DEG, key=lambda deg: land.horizon_rad(np.radians(deg)))
    horizon_deg = np.degrees(land.horizon_rad(np.radians(highest)))
    assert lit_share(simulation, horizon_deg - 0.5, highest) < 0.5

    def warnings_after(**environment: float) -> list[str]:
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            simulation.step_sample(ModuleMetadata(environment=environment))
        return [record.getMessage() for record in caplog.records]

    low = {"sun_elevation_deg": 1.0, "sun_azimuth_deg": float(highest)}
    (message,) = warnings_after(**low)
    assert "the sun is at 1.0 degrees" in message
    assert f"rises to {horizon_deg:.1f} degrees" in message
    assert "environment.sun_elevation_deg" in message
    assert warnings_after(**low) == []
    assert warnings_after(sky_strength=2.0) == []
    assert warnings_after(sun_elevation_deg=30.0) == []
    assert len(warnings_after(**low)) == 1
    # Night is no mistake.
    assert warnings_after(sun_elevation_deg=-5.0) == []


def test_the_lowest_sun_of_a_configuration_by_angle_and_by_time() -> None:
    def lowest_deg(**section: Any) -> float | None:
        lowest_rad = lowest_sun_rad(EnvironmentConfig.model_validate(section), "earth")
        return None if lowest_rad is None else float(np.degrees(lowest_rad))

    assert lowest_deg(sun_elevation_deg=(3.0, 70.0)) == pytest.approx(3.0)
    assert lowest_deg(sun_elevation_deg=(-3.0, 70.0)) == 0.0
    assert lowest_deg(sun_elevation_deg=(-9.0, -3.0)) is None
    noon = {"date_time": "2026-03-20T12:00:00+00:00", "latitude_deg": 0.0, "longitude_deg": 0.0}
    by_noon, by_evening, all_day = (
        lowest_deg(sun_from_time={**noon, "later_h": later_h}) for later_h in (0.0, (0, 5), (0, 24))
    )
    assert by_noon is not None
    assert by_noon > 85
    assert by_evening == pytest.approx(15, abs=3)
    assert all_day == 0.0
