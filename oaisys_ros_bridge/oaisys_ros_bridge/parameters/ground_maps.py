"""Parameters of the maps of the ground around the rig, which bridge and mapper share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from oaisys_core.errors import InvalidInputError
from oaisys_mapping.ground_grid import Rover
from oaisys_ros_bridge.parameters.table import ParameterRow

MAX_LENGTH_M = 1000.0
MAX_CELLS = 1000
"""Along an edge."""
MAX_RADIUS_CELLS = 20


def ground_map_rows(length_m: float, period_s: float) -> tuple[ParameterRow, ...]:
    """Return the rows, with a node's own defaults of edge and period."""
    return (
        ParameterRow(
            "ground_map.length_m",
            length_m,
            "Edge of the map of the ground around the rig, grid_map and occupancy; 0: no map.",
            unit="m",
            least=0.0,
            most=MAX_LENGTH_M,
        ),
        ParameterRow(
            "ground_map.resolution_m",
            0.2,
            f"Edge of its cells; with more than {MAX_CELLS} along an edge there is a warning, and "
            "no map.",
            unit="m",
            least=0.01,
            most=100.0,
        ),
        ParameterRow(
            "ground_map.period_s",
            period_s,
            "Least time between two maps; 0: one for each sample. Only for subscribers.",
            unit="s",
            least=0.0,
            most=86400.0,
        ),
        ParameterRow(
            "ground_map.clearance_m",
            0.3,
            "Height above the ground around it that stops the rover.",
            unit="m",
            least=0.001,
            most=100.0,
        ),
        ParameterRow(
            "ground_map.max_slope_rad",
            0.45,
            "Steepest slope that the rover drives on.",
            unit="rad",
            least=0.01,
            most=1.57,
        ),
        ParameterRow(
            "ground_map.radius_m",
            0.4,
            "Radius of the rover, within which slope, roughness and steps are found; at most "
            f"{MAX_RADIUS_CELLS} cells.",
            unit="m",
            least=0.01,
            most=50.0,
        ),
    )


def check_ground_map(values: Mapping[str, Any]) -> None:
    """Raise `InvalidInputError` where a map of the ground would take too long.

    No rule of the tables: edge and cells could then not be changed one after the other.
    """
    length_m, cell_m = values["ground_map.length_m"], values["ground_map.resolution_m"]
    if length_m > MAX_CELLS * cell_m:
        expected = f"at least {length_m / MAX_CELLS:g} m with a map of {length_m:g} m"
        raise InvalidInputError("ground_map.resolution_m", cell_m, expected)
    radius_m = values["ground_map.radius_m"]
    if radius_m > MAX_RADIUS_CELLS * cell_m:
        expected = f"at most {MAX_RADIUS_CELLS} cells, {MAX_RADIUS_CELLS * cell_m:g} m"
        raise InvalidInputError("ground_map.radius_m", radius_m, expected)


def rover_of(values: Mapping[str, Any]) -> Rover:
    """Return the rover that the values of the parameters describe."""
    return Rover(
        clearance_m=values["ground_map.clearance_m"],
        max_slope_rad=values["ground_map.max_slope_rad"],
        radius_m=values["ground_map.radius_m"],
    )
