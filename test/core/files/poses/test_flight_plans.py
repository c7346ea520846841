"""Plans of QGroundControl on a georeferenced stage, against PROJ on the file's own numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import Transformer
from scipy.spatial.transform import Rotation
from synthetic_worlds import SMALL_MATERIALS
from typer.testing import CliRunner

from oaisys_core.cli.main import app
from oaisys_core.cli.rendering.pose_steps import PoseSteps
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses import PoseSelection, flight_plans, read_pose_table
from oaisys_core.files.poses.flight_plans import read_plan
from oaisys_core.files.poses.records import MAX_POSES
from oaisys_core.simulation import Simulation

BARE: dict[str, Any] = {
    "backend": "analytic",
    "materials": SMALL_MATERIALS,
    "assets": {"rocks": []},
}
CORNER = (412_000.0, 5_322_000.0)
SIZE, PIXEL_M = 101, 2.0
TO_DEGREES = Transformer.from_crs("EPSG:32633", "EPSG:4326", always_xy=True)
MIDDLE = (CORNER[0] + SIZE * PIXEL_M / 2, CORNER[1] - SIZE * PIXEL_M / 2)


def simulation(folder: Path) -> Simulation:
    """A slope that rises 1 m in 10 m to the east, 500 m above the sea in its middle."""
    heights = 500 + 0.1 * PIXEL_M * (np.arange(SIZE) - SIZE // 2) * np.ones((SIZE, 1))
    transform = Affine(PIXEL_M, 0, CORNER[0], 0, -PIXEL_M, CORNER[1])
    kind: dict[str, Any] = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": "EPSG:32633"}
    size = {"width": SIZE, "height": SIZE, "transform": transform}
    with rasterio.open(folder / "a.tif", "w", **kind, **size) as file:
        file.write(heights.astype(np.float32), 1)
    stage = {"dem": {"file": str(folder / "a.tif")}, "surroundings": "plain"}
    made = Simulation(config_from_mapping({**BARE, "stage": stage}))
    made.step_batch()
    return made


def item(east_m: float, north_m: float, altitude_m: float, frame: int, **more: Any) -> Any:
    lon, lat = TO_DEGREES.transform(MIDDLE[0] + east_m, MIDDLE[1] + north_m)
    params = [0, 0, 0, more.get("heading"), lat, lon, altitude_m]
    command = more.get("command", 16)
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": params}


def write(path: Path, items: list[Any], home: Any = "middle") -> Path:
    lon, lat = TO_DEGREES.transform(*MIDDLE)
    position = [lat, lon, 490.0] if home == "middle" else home
    mission = {"items": items, "plannedHomePosition": position}
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    return path


def poses(made: Simulation, path: Path) -> Any:
    requests = PoseSteps(path, PoseSelection(), None).requests(made)
    of_sensors: list[Any] = [request.metadata.sensor for request in requests]
    return [each["pose"] for each in of_sensors]


def test_waypoints_are_where_the_projection_has_them(tmp_path: Path) -> None:
    survey = {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "TransectStyleComplexItem": {"Items": [item(-30, 5, 15, 10)]},
    }
    speed = {"type": "SimpleItem", "command": 178, "frame": 2, "params": [1, 5, -1, 0, 0, 0, 0]}
    items = [item(40, 20, 530, 0), speed, item(-20, 50, 40, 3, heading=90), survey]
    found = poses(simulation(tmp_path), write(tmp_path / "a.plan", items))
    # Heights of map begin at the median of the model, 500 m; home is 490 m above the sea.
    expected_m = [(40, 20, 30), (-20, 50, 30), (-30, 5, -3 + 15)]
    np.testing.assert_allclose([each.position_m for each in found], expected_m, atol=0.06)


def test_the_rig_looks_ahead_or_as_the_plan_says(tmp_path: Path) -> None:
    items = [item(0, 0, 20, 3), item(0, 40, 20, 3, heading=90.0), item(-50, 40, 20, 3)]
    found = poses(simulation(tmp_path), write(tmp_path / "a.plan", items))
    forward = [Rotation.from_quat(each.quat_xyzw).apply((1, 0, 0)) for each in found]
    # Grid north is within 1° of true north here.
    np.testing.assert_allclose(forward, [(0, 1, 0), (1, 0, 0), (-1, 0, 0)], atol=0.02)


@pytest.mark.parametrize(
    ("items", "home", "expected"),
    [
        ([], "middle", "with waypoints"),
        ([item(0, 0, 20, 3)], None, "plannedHomePosition"),
        ([item(0, 0, 20, 7)], "middle", r"items\[0\]\.frame: received 7"),
        ([item(0, 0, 20, 3, heading=1e308)], "middle", r"\[0\]\.params\[3\]: received 1e\+308"),
        ([item(900, 0, 20, 10)], "middle", "above the stage's ground"),
        ([{"type": "ComplexItem", "complexItemType": "StructureScan"}], "middle", "StructureScan"),
    ],
)
def test_plans_that_cannot_be_flown_are_refused(
    tmp_path: Path, items: list[Any], home: Any, expected: str
) -> None:
    with pytest.raises(InvalidInputError, match=expected):
        poses(simulation(tmp_path), write(tmp_path / "a.plan", items, home))


@pytest.mark.parametrize("field", ["command", "frame"])
@pytest.mark.parametrize("value", [[16], {"a": 1}, None, "NAV_TAKEOFF", True, 178.7, -1, 10**300])
def test_numbers_of_another_type_are_refused_by_their_place(
    tmp_path: Path, field: str, value: Any
) -> None:
    path = write(tmp_path / "a.plan", [item(0, 0, 20, 3), item(0, 0, 20, 3) | {field: value}])
    expected = rf"mission\.items\[1\]\.{field}: received .{{1,90}}, expected a MAV_"
    with pytest.raises(InvalidInputError, match=expected) as refused:
        read_plan(path)
    assert len(str(refused.value)) < 300


def test_a_stage_of_no_place_takes_no_plan(tmp_path: Path) -> None:
    made = Simulation(
        config_from_mapping({**BARE, "stage": {"surroundings": "plain", "resolution_px": 33}})
    )
    made.step_batch()
    path = write(tmp_path / "a.plan", [item(0, 0, 20, 0)])
    with pytest.raises(InvalidInputError, match="elevation model that says where it lies"):
        poses(made, path)
    with pytest.raises(InvalidInputError, match="oaisys render --poses alone"):
        read_pose_table(path)


def test_a_plan_has_no_more_waypoints_than_other_files_have_poses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert vars(flight_plans)["MAX_POSES"] == MAX_POSES
    at_most = 1000
    monkeypatch.setattr(flight_plans, "MAX_POSES", at_most)
    survey = {"type": "ComplexItem", "TransectStyleComplexItem": {"Items": [item(0, 0, 20, 3)] * 2}}
    path = write(tmp_path / "a.plan", [item(0, 0, 20, 3)] * (at_most - 1) + [survey])
    expected = f"poses: received '{at_most + 1} waypoints in .*, expected at most {at_most}"
    with pytest.raises(InvalidInputError, match=expected):
        flight_plans.read_plan(path)


def test_the_command_renders_a_plan(tmp_path: Path) -> None:
    simulation(tmp_path).close()
    config = tmp_path / "world.yaml"
    config.write_text(
        "backend: analytic\n"
        "stage: {dem: {file: a.tif}, surroundings: plain}\n"
        "materials: {texture_size_px: 16, mask: {size_px: 16, relief: 0}}\n"
        "assets: {rocks: []}\n"
        "sensors: {cameras: [{width_px: 8, height_px: 6}]}\n"
    )
    plan = write(tmp_path / "a.plan", [item(0, 0, 40, 3), item(10, 0, 40, 3)])
    line = ["render", "--config", str(config), "--poses", str(plan), "--out", str(tmp_path / "o")]
    result = CliRunner().invoke(app, line)
    assert result.exit_code == 0, result.output
    assert len(list((tmp_path / "o").rglob("*rgb*.png"))) == 2
