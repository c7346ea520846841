"""Maps of the mapped ground around the rig, compared with the true one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from grid_map_msgs.msg import GridMap
from nav_msgs.msg import OccupancyGrid
from ros_peer import Stage
from sensor_msgs.msg import Image
from served_simulator import FLAT_WORLD

from oaisys_core.geometry import pose_looking_down
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS

pytestmark = pytest.mark.ros

CELL_M = 0.25
PREFIXES = ("ground_truth", "oaisys_mapper")
WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 32, "resolution_px": 129},
    "sensors": {"cameras": [{"width_px": 160, "height_px": 120, "fx_px": 100, "fy_px": 100}]},
}


def parameters(*more: str) -> list[str]:
    values = ("ground_map.length_m:=14.0", f"ground_map.resolution_m:={CELL_M}", *more)
    return [part for each in (*values, "ground_map.period_s:=0.0") for part in ("-p", each)]


def layers_of(message: GridMap) -> dict[str, np.ndarray[Any, Any]]:
    """Return the layers, rows upwards along y."""
    count = message.data[0].layout.dim[0].size
    return {
        name: np.reshape(data.data, (count, count))[::-1, ::-1]
        for name, data in zip(message.layers, message.data, strict=True)
    }


def map_of(stage: Stage, prefix: str, stamp: Any) -> GridMap:
    messages = stage.user.received[f"{prefix}/grid_map"]

    def found() -> GridMap | None:
        return next((each for each in messages if each.header.stamp == stamp), None)

    message: GridMap = stage.user.wait_until(found)
    return message


@pytest.mark.long
def test_the_mapped_ground_is_the_true_one_where_it_was_seen(stage: Stage) -> None:
    user = stage.user
    server = stage.start_world(WORLD)
    for prefix in PREFIXES:
        user.listen(GridMap, f"{prefix}/grid_map", LATCHED_QOS)
        user.listen(OccupancyGrid, f"{prefix}/occupancy", LATCHED_QOS)
    user.listen(Image, "camera/depth/image_raw", SENSOR_QOS)
    address = f"address:={server.address}"
    stage.start_node("bridge", "--ros-args", *parameters(address))
    stage.start_node("mapper", "--ros-args", *parameters("use_semantics:=true"))
    user.wait_until_ready()
    user.wait_until_matched(["/camera/depth/image_raw"], subscribers=2)

    answer = user.set_pose(pose_looking_down(1.0, -2.0, 8.0))
    assert answer.success, answer.message
    found = {prefix: map_of(stage, prefix, answer.stamp) for prefix in PREFIXES}
    assert found["ground_truth"].info == found["oaisys_mapper"].info
    true, mapped = (layers_of(found[prefix]) for prefix in PREFIXES)
    seen = np.isfinite(mapped["elevation"])
    assert 0.2 < seen.mean() < 1.0
    errors_m = (mapped["elevation"] - true["elevation"])[seen]
    assert abs(np.median(errors_m)) < 0.05
    assert np.mean(np.abs(errors_m) < 0.15) > 0.9
    for name in ("slope", "traversability"):
        both = np.isfinite(mapped[name]) & np.isfinite(true[name])
        assert np.median(np.abs(mapped[name] - true[name])[both]) < 0.1
    assert np.mean((mapped["class"] == true["class"])[seen]) > 0.9

    user.wait_until(lambda: user.received["oaisys_mapper/occupancy"])
    occupancy = user.received["oaisys_mapper/occupancy"][-1]
    cells = np.reshape(occupancy.data, (occupancy.info.height, occupancy.info.width))
    unknown = np.isnan(mapped["traversability"])
    np.testing.assert_array_equal(cells == -1, unknown)
    expected = np.rint(100 * (1 - mapped["traversability"][~unknown]))
    np.testing.assert_array_equal(cells[~unknown], expected)
