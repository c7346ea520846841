"""Readers of maps of the ground, written from the definitions of their messages alone."""

from __future__ import annotations

import math

from grid_map_msgs.msg import GridMap
from nav_msgs.msg import OccupancyGrid

NO_INFORMATION, LETHAL, FREE = 255, 254, 0
"""Costs of a Nav2 costmap (`cost_values.hpp`)."""


def read_layer(message: GridMap, name: str, x_m: float, y_m: float) -> float:
    """Return a layer's value at a place, by what the definitions say about dimensions and order.

    Rows go along -x and columns along -y from the corner with the largest x and y; data is a
    circular buffer that begins at the start indices, and the labels say which index is the outer.
    """
    data = message.data[message.layers.index(name)]
    sizes = {dim.label: dim.size for dim in data.layout.dim}
    info = message.info
    row = int((info.pose.position.x + info.length_x / 2 - x_m) / info.resolution)
    column = int((info.pose.position.y + info.length_y / 2 - y_m) / info.resolution)
    assert sizes["row_index"] == round(info.length_x / info.resolution)
    assert sizes["column_index"] == round(info.length_y / info.resolution)
    row = (row + message.outer_start_index) % sizes["row_index"]
    column = (column + message.inner_start_index) % sizes["column_index"]
    outer, inner = data.layout.dim
    index = {"row_index": row, "column_index": column}
    assert outer.stride == outer.size * inner.size
    assert inner.stride == inner.size
    offset = data.layout.data_offset + index[outer.label] * inner.stride + index[inner.label]
    return float(data.data[offset])


def read_occupancy(message: OccupancyGrid, x_m: float, y_m: float) -> int:
    """Return the value of the cell at a place: row-major, from the origin's corner on.

    The origin is the pose of cell (0, 0), whose axes the map has.
    """
    info = message.info
    q = info.origin.orientation
    assert (q.x, q.y) == (0.0, 0.0)
    yaw = 2 * math.atan2(q.z, q.w)
    east_m, north_m = x_m - info.origin.position.x, y_m - info.origin.position.y
    column = int((math.cos(yaw) * east_m + math.sin(yaw) * north_m) / info.resolution)
    row = int((-math.sin(yaw) * east_m + math.cos(yaw) * north_m) / info.resolution)
    assert 0 <= column < info.width
    assert 0 <= row < info.height
    return int(message.data[row * info.width + column])


def static_layer_cost(value: int, lethal_threshold: int = 100) -> int:
    """Return the cost that Nav2's static layer makes of a value, with `trinary_costmap` off."""
    if value == -1:
        return NO_INFORMATION
    assert 0 <= value <= 100
    if value >= lethal_threshold:
        return LETHAL
    return int(value / lethal_threshold * LETHAL)
