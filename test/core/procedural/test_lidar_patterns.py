"""Directions and times of lidars' rays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from oaisys_core.config.sections.sensing.lidars import LidarConfig
from oaisys_core.errors import ConfigError
from oaisys_core.procedural.lidar_patterns import scan_pattern
from oaisys_core.scene import ScanPattern


def pattern(number: int = 0, **scan: Any) -> ScanPattern:
    return scan_pattern(LidarConfig.model_validate({"scan": scan}), number)


def angles_deg(rays: ScanPattern) -> tuple[Any, Any]:
    x, y, z = rays.directions.T
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z))


@pytest.mark.parametrize("channels", [16, 32, 64, 128])
def test_presets_have_their_channels(channels: int) -> None:
    rays = pattern(kind="rotating", preset=f"generic_{channels}", azimuth_steps=90)
    assert len(rays.directions) == 90 * channels
    assert set(rays.rings) == set(range(channels))
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1)


def test_a_rotating_lidar_turns_counter_clockwise_and_fires_its_columns_in_turn() -> None:
    rays = pattern(kind="rotating", elevations_deg=[-10, 0, 5], azimuth_steps=4)
    azimuth, elevation = angles_deg(rays)
    np.testing.assert_allclose(np.cos(np.radians(azimuth[::3])), [-1, 0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(azimuth[3:6], -90)
    np.testing.assert_allclose(elevation, [-10, 0, 5] * 4, atol=1e-9)
    np.testing.assert_allclose(rays.times_s, np.repeat([0, 0.025, 0.05, 0.075], 3))
    assert rays.rings.tolist() == [0, 1, 2] * 4


def test_a_rosette_fills_its_field_of_view_and_goes_on_from_scan_to_scan() -> None:
    first, second = (pattern(number, kind="rosette") for number in (0, 1))
    off_axis = np.degrees(np.arccos(first.directions[:, 0]))
    assert off_axis.max() == pytest.approx(19.2, abs=0.01)
    assert off_axis.min() < 0.5
    step = np.arccos(np.clip(first.directions[-1] @ second.directions[0], -1, 1))
    neighbours = np.arccos(np.clip((first.directions[1:] * first.directions[:-1]).sum(1), -1, 1))
    assert step <= neighbours.max() * 1.01
    assert not np.allclose(first.directions, second.directions, atol=1e-3)


def test_a_rosettes_petals_follow_its_formula() -> None:
    rays = pattern(kind="rosette", points=7, field_of_view_deg=40, first_prism_hz=3.0)
    t, radius = rays.times_s, np.radians(20)
    left = radius / 2 * (np.cos(6 * np.pi * t) + np.cos(2 * np.pi * -4664 / 60 * t))
    up = radius / 2 * (np.sin(6 * np.pi * t) + np.sin(2 * np.pi * -4664 / 60 * t))
    x, y, z = rays.directions.T
    np.testing.assert_allclose(np.arccos(x), np.hypot(left, up), atol=1e-7)
    np.testing.assert_allclose(y * up, z * left, atol=1e-12)


def test_a_raster_runs_row_by_row_from_the_upper_left() -> None:
    rays = pattern(kind="raster", columns=3, rows=2, horizontal_fov_deg=60, vertical_fov_deg=20)
    azimuth, elevation = angles_deg(rays)
    np.testing.assert_allclose(azimuth, [30, 0, -30] * 2, atol=1e-9)
    np.testing.assert_allclose(elevation, [10] * 3 + [-10] * 3, atol=1e-9)
    assert rays.rings.tolist() == [1, 1, 1, 0, 0, 0]
    np.testing.assert_allclose(rays.times_s, np.arange(6) / 60)


def test_rays_of_a_file_are_sorted_by_time(tmp_path: Path) -> None:
    path = tmp_path / "rays.csv"
    path.write_text("azimuth_deg,elevation_deg,time_s,ring\n90,0,0.02,4\n0,-30,0.01,3\n")
    rays = pattern(kind="csv", path=str(path))
    azimuth, elevation = angles_deg(rays)
    np.testing.assert_allclose(azimuth, [0, 90])
    np.testing.assert_allclose(elevation, [-30, 0], atol=1e-9)
    assert (rays.times_s.tolist(), rays.rings.tolist()) == ([0.01, 0.02], [3, 4])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "azimuth_deg,elevation_deg\n1,2\n",
        "azimuth_deg,elevation_deg,time_s\n1,x,0\n",
        "azimuth_deg,elevation_deg,time_s\n1_0,2,0\n",
        "azimuth_deg,elevation_deg,time_s,ring\n1,2,0,1_0\n",
        "azimuth_deg,elevation_deg,time_s\n1,2,-1\n",
        "azimuth_deg,elevation_deg,time_s\n1,nan,0\n",
    ],
)
def test_a_file_without_rays_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "broken.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"broken\.csv"):
        pattern(kind="csv", path=str(path))


@pytest.mark.parametrize(
    "scan",
    [
        {"kind": "rotating", "preset": "generic_65"},
        {"kind": "rotating", "elevations_deg": [3, 1]},
        {"kind": "rotating", "elevations_deg": [1, 3], "channels": 3},
        {"kind": "rotating", "azimuth_min_deg": 10, "azimuth_max_deg": 5},
        {"kind": "rotating", "channels": 4096, "azimuth_steps": 4000},
    ],
)
def test_impossible_scans_are_refused(scan: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        LidarConfig.model_validate({"scan": scan})
