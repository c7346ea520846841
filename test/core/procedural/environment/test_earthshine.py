"""Sunlight from Earth on the Moon, against a sphere's integral and an eclipse's geometry."""

from __future__ import annotations

from math import cos, pi
from typing import Any

import numpy as np
import pytest
from scipy.integrate import dblquad
from synthetic_worlds import SMALL_MATERIALS

from oaisys_core.color import linear
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.environment.earthshine import lambert_phase
from oaisys_core.simulation import Simulation

pytest.importorskip("skyfield", reason="the ephemeris is an extra", exc_type=ModuleNotFoundError)

NEW_MOON = "2024-04-08T18:21:00Z"
"""Greatest eclipse of the sun; the Moon was 359,800 km from Earth's centre (NASA)."""


def moon(longitude_deg: float, **sun: Any) -> Simulation:
    when = {"date_time": NEW_MOON, "latitude_deg": 0.0, "longitude_deg": longitude_deg}
    found = Simulation(
        config_from_mapping(
            {
                "backend": "analytic",
                "render": {"quality": "draft"},
                "stage": {
                    "preset": "plane",
                    "extent_m": 40.0,
                    "resolution_px": 33,
                    "body": "moon",
                    "surroundings": "plain",
                },
                "materials": {**SMALL_MATERIALS, "reflectance": "lambert"},
                "assets": {"rocks": []},
                "environment": {
                    "sky": {"model": "none"},
                    "sun_strength_w_m2": 4.0,
                    "sun_from_time": {**when, **sun},
                },
                "sensors": {
                    "cameras": [
                        {"width_px": 16, "height_px": 12, "modalities": ["radiance", "albedo"]}
                    ],
                    "motion": {"kind": "grid", "columns": 1, "rows": 1},
                },
            }
        )
    )
    found.step_batch()
    return found


@pytest.mark.parametrize("phase_rad", [0.0, 0.6, 1.5, 2.8])
def test_the_phase_function_is_the_integral_over_a_sphere(phase_rad: float) -> None:
    """With the eye over longitude 0 and the sun at the phase angle."""
    light, _ = dblquad(
        lambda lat, lon: cos(lat) ** 3 * cos(lon) * cos(lon - phase_rad),
        phase_rad - pi / 2,
        pi / 2,
        -pi / 2,
        pi / 2,
    )
    assert lambert_phase(phase_rad) == pytest.approx(light / (2 * pi / 3), abs=1e-6)


def test_the_full_earth_lights_the_night_of_the_moon() -> None:
    simulation = moon(0.0, earthshine=True)
    (lamp,) = simulation.scene.lamps
    position_m = np.array(lamp.position_m)
    assert position_m[2] / np.linalg.norm(position_m) > cos(0.15), "Earth is near the zenith"
    sample = simulation.step_sample()
    images = {frame.modality: frame.data.astype(np.float64) for frame in sample.frames}
    unit_w_m2 = np.array(simulation.scene.sky.unit_w_m2)
    albedo = linear(images["albedo"] / 255)
    irradiance = pi * images["radiance"].mean(axis=(0, 1)) / albedo.mean(axis=(0, 1)) / unit_w_m2
    expected = 4.0 * 2 / 3 * 0.297 * (6378.1 / (359_800 - 1737)) ** 2
    of_lamp = lamp.strength_w / (4 * pi * (position_m @ position_m))
    assert of_lamp == pytest.approx(expected, rel=0.01)
    # The texture's relief turns some of the ground away.
    np.testing.assert_allclose(irradiance, expected, rtol=0.1)


def test_there_is_none_without_the_option_on_the_far_side_or_on_other_bodies() -> None:
    assert moon(0.0).scene.lamps == ()
    assert moon(180.0, earthshine=True).scene.lamps == ()
    config = {
        "backend": "analytic",
        "stage": {"preset": "plane", "extent_m": 40.0, "resolution_px": 33, "body": "mars"},
        "materials": SMALL_MATERIALS,
        "assets": {"rocks": []},
        "environment": {
            "sun_from_time": {
                "date_time": NEW_MOON,
                "latitude_deg": 0.0,
                "longitude_deg": 0.0,
                "earthshine": True,
            }
        },
    }
    with pytest.raises(InvalidInputError, match="Earth lights the Moon alone"):
        Simulation(config_from_mapping(config)).step_batch()
