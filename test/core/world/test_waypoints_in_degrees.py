"""Motions and movers whose places are longitudes and latitudes, against PROJ."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Proj, Transformer

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.simulation import Simulation

SYSTEM = CRS.from_user_input("+proj=stere +lat_0=-90 +R=1737400 +units=m +type=crs")
MIDDLE = (90_040.0, -60_040.0)
"""x and y in the middle of the file; +y is 56 degrees from true north there."""
MEDIAN_M = 700.0
LABEL = {"label": "rover", "semantic_id": 9}


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("dem") / "plain.tif"
    place = Affine(2.0, 0.0, MIDDLE[0] - 41.0, 0.0, -2.0, MIDDLE[1] + 41.0)
    profile: dict[str, Any] = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": SYSTEM}
    with rasterio.open(path, "w", **profile, width=41, height=41, transform=place) as file:
        file.write(np.full((41, 41), MEDIAN_M, np.float32), 1)
    return path


def degrees_of(x_m: float, y_m: float) -> tuple[float, float]:
    to_degrees = Transformer.from_crs(SYSTEM, SYSTEM.geodetic_crs, always_xy=True)
    # Metres of the map are longer than true ones, the more so the farther from the pole.
    here = to_degrees.transform(*MIDDLE)
    scale = Proj(SYSTEM).get_factors(*here).meridional_scale
    lon, lat = to_degrees.transform(MIDDLE[0] + scale * x_m, MIDDLE[1] + scale * y_m)
    return float(lon), float(lat)


def simulation(stage: dict[str, Any], **more: Any) -> Simulation:
    mapping = {
        "backend": "analytic",
        "render": {"quality": "geometry"},
        "stage": {**stage, "surroundings": "plain", "body": "moon"},
        "assets": {"rocks": [], **more.get("assets", {})},
        "sensors": {"cameras": [{"width_px": 16, "height_px": 12}], **more.get("sensors", {})},
    }
    found = Simulation(config_from_mapping(mapping))
    found.step_batch()
    return found


def rig_m(found: Simulation, samples: int) -> list[tuple[float, ...]]:
    positions: list[tuple[float, ...]] = []
    for _ in range(samples):
        found.step_sample()
        pose = found.info().rig_pose
        assert pose is not None
        positions.append(pose.position_m)
    return positions


MOTIONS: dict[str, tuple[dict[str, Any], list[tuple[float, float, float]]]] = {
    "spline": (
        {
            "kind": "spline",
            "waypoints_lon_lat_deg": [(*degrees_of(-8, 4), 705.0), (*degrees_of(8, 4), 705.0)],
            "step_m": 8.0,
        },
        [(-8, 4, 5), (0, 4, 5), (8, 4, 5)],
    ),
    "spline above the ground": (
        {
            "kind": "spline",
            "waypoints_lon_lat_deg": [degrees_of(3, -6), degrees_of(3, 6)],
            "step_m": 12.0,
            "height_above_ground_m": [2.0, 2.0],
        },
        [(3, -6, 2), (3, 6, 2)],
    ),
    "grid": (
        {"kind": "grid", "columns": 1, "rows": 1, "centre_lon_lat_deg": degrees_of(5, -7)},
        [(5, -7, 10)],
    ),
    "target": (
        {
            "kind": "around_target",
            "target_lon_lat_deg": (*degrees_of(6, 2), 701.0),
            "distance_m": [5.0, 5.0],
            "elevation_deg": [0.0, 0.0],
            "azimuth_deg": [180.0, 180.0],
        },
        [(1, 2, 1)],
    ),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_the_rig_is_where_proj_puts_it(dem: Path, name: str) -> None:
    motion, expected_m = MOTIONS[name]
    found = simulation({"dem": {"file": str(dem)}}, sensors={"motion": motion})
    positions_m = rig_m(found, len(expected_m))
    np.testing.assert_allclose(positions_m, expected_m, atol=2e-3)


def test_a_mover_is_where_proj_puts_it(dem: Path) -> None:
    way = {"waypoints_lon_lat_deg": [degrees_of(-4, 1), degrees_of(4, 1)], "step_m": 6.0}
    assets = {"movers": [{"name": "rover", "shape": "rover", "trajectory": way, **LABEL}]}
    found = simulation({"dem": {"file": str(dem)}}, assets=assets)
    for x_m in (-4.0, 2.0):
        (mover,) = (each for each in found.scene.placements if each.is_moving)
        np.testing.assert_allclose(mover.T_map_object[0, :2, 3], (x_m, 1.0), atol=2e-3)
        found.step_sample(None)


def test_stages_of_no_place_refuse_degrees() -> None:
    flat = {"preset": "plane", "extent_m": 40.0, "resolution_px": 33}
    for name, (motion, _) in MOTIONS.items():
        with pytest.raises(InvalidInputError, match=r"_lon_lat_deg: .*oaisys place info"):
            rig_m(simulation(flat, sensors={"motion": motion}), 1)
        assert name
    way = {"waypoints_lon_lat_deg": [(1, 2), (3, 4)]}
    mover = {"name": "m", "shape": "rover", "trajectory": way, **LABEL}
    with pytest.raises(InvalidInputError, match=r"assets\.movers\.m\.trajectory\.waypoints_lon"):
        simulation(flat, assets={"movers": [mover]})


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        ({"kind": "spline"}, "one of waypoints_m and waypoints_lon_lat_deg"),
        ({"kind": "spline", "waypoints_lon_lat_deg": [(1, 2), (3, 4)]}, "height_above_ground_m"),
        ({"kind": "spline", "waypoints_lon_lat_deg": [(1, 2, 3)]}, "at least two waypoints"),
        (
            {"kind": "grid", "centre_m": [0, 0], "centre_lon_lat_deg": [0, 0]},
            "either centre_m or centre_lon_lat_deg",
        ),
        ({"kind": "around_target", "target_lon_lat_deg": [0, 95]}, r"received 95"),
    ],
)
def test_ways_that_are_unclear_are_refused(motion: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        config_from_mapping({"sensors": {"motion": motion}})
