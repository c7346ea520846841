"""Maps of grounds in closed form, as readers of definitions and Nav2's static layer see them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from grid_map_msgs.msg import GridMap
from grid_readers import FREE, LETHAL, NO_INFORMATION, read_layer, read_occupancy, static_layer_cost
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header

from oaisys_mapping.ground_grid import GridPlace, GroundGrid, Rover
from oaisys_ros_bridge.ground_maps import ground_msgs

PLACE = GridPlace((-3.0, 5.0), 0.25, 40)
"""x from -3 to 7, y from 5 to 15 m: no symmetry hides an exchange of axes."""
ROVER = Rover(clearance_m=0.3, max_slope_rad=0.5, radius_m=0.5)
STEP_X_M, STEP_M = 1.0, 0.8
UNKNOWN_Y_M = 13.0
Height = Callable[[Any, Any], Any]


def plane_m(x: Any, y: Any) -> Any:
    return 0.3 * x - 0.1 * y + 2.0


def step_m(x: Any, y: Any) -> Any:
    return np.where(np.asarray(x) < STEP_X_M, 0.0, STEP_M) + 0.0 * y


def maps(height_m: Height) -> tuple[GridMap, OccupancyGrid]:
    """Return the messages of a ground that is unknown in the far y, after a way over the wire."""
    x, y = np.meshgrid(-3.0 + 0.25 * (np.arange(40) + 0.5), 5.0 + 0.25 * (np.arange(40) + 0.5))
    known = np.where(y < UNKNOWN_Y_M, height_m(x, y), np.nan).astype(np.float32)
    classes = np.where(x < STEP_X_M, 3, 20).astype(np.uint16)
    header = Header(stamp=Time(sec=9), frame_id="map")
    grid_map, occupancy = ground_msgs(GroundGrid(PLACE, known, classes), ROVER, header)
    return (
        deserialize_message(serialize_message(grid_map), GridMap),
        deserialize_message(serialize_message(occupancy), OccupancyGrid),
    )


def middles(low_y_m: float, high_y_m: float) -> NDArray[Any]:
    """Return (N, 2) middles of cells drawn in a range of y."""
    rng = np.random.default_rng(11)
    columns = rng.integers(4, 36, 150)
    rows = rng.integers(round((low_y_m - 5) / 0.25), round((high_y_m - 5) / 0.25), 150)
    return np.column_stack((-3.0 + 0.25 * (columns + 0.5), 5.0 + 0.25 * (rows + 0.5)))


@pytest.mark.parametrize("height_m", [plane_m, step_m])
def test_heights_are_where_the_definition_of_grid_map_has_them(height_m: Height) -> None:
    grid_map, _ = maps(height_m)
    assert (grid_map.header.frame_id, grid_map.header.stamp.sec) == ("map", 9)
    assert list(grid_map.basic_layers) == ["elevation"]
    for x, y in middles(5.0, UNKNOWN_Y_M):
        found = read_layer(grid_map, "elevation", x, y)
        assert found == pytest.approx(float(height_m(x, y)), abs=1e-6)
        assert read_layer(grid_map, "class", x, y) == (3 if x < STEP_X_M else 20)
    for x, y in middles(UNKNOWN_Y_M, 15.0):
        assert math.isnan(read_layer(grid_map, "elevation", x, y))


def test_a_plane_costs_its_slope() -> None:
    grid_map, occupancy = maps(plane_m)
    slope_rad = math.atan(math.hypot(0.3, 0.1))
    expected = round(100 * slope_rad / ROVER.max_slope_rad)
    for x, y in middles(6.0, 12.0):
        assert read_layer(grid_map, "slope", x, y) == pytest.approx(slope_rad, abs=1e-4)
        assert read_occupancy(occupancy, x, y) == expected
        assert static_layer_cost(expected) == int(expected / 100 * LETHAL)


def test_a_step_is_lethal_and_level_ground_is_free() -> None:
    _, occupancy = maps(step_m)
    for x, y in middles(6.0, 12.0):
        cost = static_layer_cost(read_occupancy(occupancy, x, y))
        if abs(x - STEP_X_M) > ROVER.radius_m + 0.25:
            assert cost == FREE
        elif abs(x - STEP_X_M) < 0.25:
            assert cost == LETHAL
    for x, y in middles(UNKNOWN_Y_M + 0.75, 15.0):
        assert static_layer_cost(read_occupancy(occupancy, x, y)) == NO_INFORMATION


def test_a_map_whose_buffer_is_moved_reads_the_same() -> None:
    """The reader itself: grid_map moves the start of its circular buffer; ours begins at 0."""
    grid_map, _ = maps(plane_m)
    before = [read_layer(grid_map, "elevation", x, y) for x, y in middles(5.0, UNKNOWN_Y_M)]
    values = np.reshape(grid_map.data[0].data, (40, 40))  # columns, rows
    grid_map.data[0].data = np.roll(values, (3, 7), axis=(0, 1)).ravel().tolist()
    grid_map.inner_start_index, grid_map.outer_start_index = 3, 7
    after = [read_layer(grid_map, "elevation", x, y) for x, y in middles(5.0, UNKNOWN_Y_M)]
    assert after == before
