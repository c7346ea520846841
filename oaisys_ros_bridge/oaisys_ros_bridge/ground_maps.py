"""Messages of the ground around the rig: ``grid_map_msgs/GridMap`` and ``nav_msgs/OccupancyGrid``.

`GroundGrid` has its rows along y and its columns along x, both upwards. An ``OccupancyGrid`` has
the same. A ``GridMap`` has its rows along x and its columns along y, both downwards, and is stored
column after column: its first value is at the largest x and y, and the next ones are at smaller x.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion
from grid_map_msgs.msg import GridMap, GridMapInfo
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from std_msgs.msg import Float32MultiArray, Header, MultiArrayDimension, MultiArrayLayout

from oaisys_mapping.ground_grid import GridPlace, GroundGrid, Rover, ground_layers
from oaisys_ros_bridge.conversions import array_of

UNKNOWN, OCCUPIED = -1, 100
"""Values of an ``OccupancyGrid``; 0 is free."""


def ground_msgs(grid: GroundGrid, rover: Rover, header: Header) -> tuple[GridMap, OccupancyGrid]:
    """Return both messages of a grid; ``header`` is of the world's frame."""
    layers = ground_layers(grid, rover)
    occupancy = occupancy_to_msg(grid.place, layers["traversability"], header)
    return grid_map_to_msg(grid.place, layers, header), occupancy


def grid_map_to_msg(
    place: GridPlace, layers: Mapping[str, NDArray[np.float32]], header: Header
) -> GridMap:
    """Return the message of layers (count, count), rows along y; the first is the basic one."""
    length_m = place.count * place.cell_m
    x_m, y_m = (each + length_m / 2 for each in place.min_xy_m)
    pose = Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion(w=1.0))
    return GridMap(
        header=header,
        info=GridMapInfo(resolution=place.cell_m, length_x=length_m, length_y=length_m, pose=pose),
        layers=list(layers),
        basic_layers=list(layers)[:1],
        data=[_multi_array(layer) for layer in layers.values()],
    )


def _multi_array(layer: NDArray[np.float32]) -> Float32MultiArray:
    rows, columns = layer.shape[1], layer.shape[0]  # of the message: along x, and along y
    values = array_of("f", np.asarray(layer[::-1, ::-1], np.float32))
    layout = MultiArrayLayout(
        dim=[
            MultiArrayDimension(label="column_index", size=columns, stride=rows * columns),
            MultiArrayDimension(label="row_index", size=rows, stride=rows),
        ]
    )
    return Float32MultiArray(layout=layout, data=values)


def occupancy_to_msg(
    place: GridPlace, traversability: NDArray[np.float32], header: Header
) -> OccupancyGrid:
    """Return the message of a layer (count, count): 1 is free, 0 occupied, NaN unknown."""
    occupied = np.rint(OCCUPIED * (1.0 - traversability))
    cells = np.where(np.isfinite(occupied), occupied, UNKNOWN).astype(np.int8)
    x_m, y_m = place.min_xy_m
    info = MapMetaData(
        map_load_time=header.stamp,
        resolution=place.cell_m,
        width=place.count,
        height=place.count,
        origin=Pose(position=Point(x=x_m, y=y_m), orientation=Quaternion(w=1.0)),
    )
    return OccupancyGrid(header=header, info=info, data=array_of("b", cells))
