"""Waypoints of QGroundControl's plans, in degrees, and their poses in ``map``.

Items, commands and frames are those of MAVLink (``MAV_CMD``, ``MAV_FRAME``) and of the plan file
format of QGroundControl's developer guide.
"""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import cos, isfinite, radians, sin
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.documents import parse_json, read_text
from oaisys_core.files.poses.records import MAX_POSES
from oaisys_core.geometry import places
from oaisys_core.types import FloatArray, Georeference, Pose

MAX_BYTES = 50_000_000

POSITIONED = frozenset({16, 17, 18, 19, 21, 22, 31, 82, 84, 85})
"""Commands to go somewhere: waypoint, loiter, land, take off, spline waypoint, of both kinds of
aircraft."""

AMSL, ABOVE_HOME, ABOVE_GROUND = frozenset({0, 5}), frozenset({3, 6}), frozenset({10, 11})
"""Frames by what altitudes are counted from."""

COMMAND = "a MAV_CMD, a whole number"
FRAME = "a MAV_FRAME of 0, 3 or 10 (above sea level, home or ground)"
"""What errors expect."""

LARGEST_NUMBER = 65_535
"""Of a command: MAVLink sends 16 bits."""

Heights = Callable[[FloatArray], FloatArray]
"""Returns the (N,) heights of the ground under (N, 2) points in ``map``."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Waypoint:
    """A place of a plan.

    Attributes:
        where: Where it stands in the file, for errors.
        lon_deg, lat_deg: Its place; longitude is positive to the east.
        altitude_m: Its altitude.
        frame: A ``MAV_FRAME``, which says what the altitude is counted from.
        heading_deg: Clockwise from true north; None: towards the next one.
    """

    where: str
    lon_deg: float
    lat_deg: float
    altitude_m: float
    frame: int
    heading_deg: float | None

    def __post_init__(self) -> None:
        if self.heading_deg is not None and abs(self.heading_deg) > 360:
            expected = "a heading from -360 to 360 degrees, or null"
            raise InvalidInputError(f"{self.where}.params[3]", self.heading_deg, expected)


@dataclass(frozen=True)
class FlightPlan:
    """The waypoints of a plan, and its home: longitude, latitude, altitude above sea level."""

    path: Path
    waypoints: tuple[Waypoint, ...]
    home: tuple[float, float, float] | None

    def poses(self, georeference: Georeference | None, heights: Heights) -> list[Pose]:
        """Return level poses of the rig in ``map``.

        Raises:
            InvalidInputError: The ground is of no place, a waypoint is not on it, or home is
                missing.
        """
        if georeference is None:
            expected = (
                "a stage from an elevation model that says where it lies, because its places are"
                " in degrees (docs/places.md)"
            )
            raise InvalidInputError("poses", str(self.path), expected)
        degrees = [(each.lon_deg, each.lat_deg, each.altitude_m) for each in self.waypoints]
        points_m = places.points_in_map(georeference, degrees)
        for index, each in enumerate(self.waypoints):
            if each.frame not in AMSL:
                points_m[index, 2] = each.altitude_m + self._base_m(
                    each, points_m[index], georeference, heights
                )
        north_deg = places.north_deg(georeference)
        yaws = [self._yaw_rad(index, points_m, north_deg) for index in range(len(points_m))]
        return [
            Pose((x, y, z), (0.0, 0.0, sin(yaw / 2), cos(yaw / 2)))
            for (x, y, z), yaw in zip(points_m.tolist(), yaws, strict=True)
        ]

    def _base_m(
        self, waypoint: Waypoint, point_m: FloatArray, georeference: Georeference, heights: Heights
    ) -> float:
        """Return the height in ``map`` from which an altitude is counted."""
        if waypoint.frame in ABOVE_HOME:
            if self.home is None:
                expected = "three numbers, because altitudes are counted from there"
                raise InvalidInputError("mission.plannedHomePosition", None, expected)
            return float(places.points_in_map(georeference, self.home)[0, 2])
        (ground_m,) = heights(point_m[None, :2])
        if not isfinite(ground_m):
            found = f"longitude {waypoint.lon_deg:.9g}, latitude {waypoint.lat_deg:.9g}"
            raise InvalidInputError(waypoint.where, found, "a place above the stage's ground")
        return float(ground_m)

    def _yaw_rad(self, index: int, points_m: FloatArray, north_deg: float) -> float:
        """Return the angle from +x towards +y."""
        heading_deg = self.waypoints[index].heading_deg
        if heading_deg is not None:
            return radians(90.0 - (heading_deg - north_deg))
        last = len(points_m) - 1
        start, end = (index, index + 1) if index < last else (max(last - 1, 0), last)
        dx, dy, _ = points_m[end] - points_m[start]
        return float(np.arctan2(dy, dx))


def is_plan(data: Any) -> bool:
    """Return whether JSON data is a plan of QGroundControl."""
    return isinstance(data, Mapping) and data.get("fileType") == "Plan"


def read_plan(path: Path) -> FlightPlan | None:
    """Return the plan in a file; None if the file is none.

    Raises:
        InvalidInputError: It has no waypoint, or one is wrong.
    """
    if path.suffix.lower() != ".plan":
        return None
    try:
        data = parse_json(read_text(path, MAX_BYTES).removeprefix("\ufeff"))
    except (OSError, ValueError) as error:
        raise InvalidInputError("poses", str(path), f"a readable plan ({error})") from error
    mission = data.get("mission") if is_plan(data) else None
    if not isinstance(mission, Mapping) or not isinstance(mission.get("items"), list):
        raise InvalidInputError("poses", str(path), "a plan of QGroundControl with a mission")
    left_out: Counter[int] = Counter()
    waypoints = []
    for where, item in _simple_items(mission["items"], f"{path}: mission.items"):
        found = _waypoint(where, item)
        if found is None:
            left_out[int(item["command"])] += 1
        else:
            waypoints.append(found)
    if not waypoints:
        raise InvalidInputError("poses", str(path), "a plan with waypoints")
    if len(waypoints) > MAX_POSES:
        received = f"{len(waypoints)} waypoints in {path}"
        raise InvalidInputError("poses", received, f"at most {MAX_POSES}")
    if left_out:
        told = ", ".join(f"{command} ({count})" for command, count in sorted(left_out.items()))
        _LOG.warning("%s: commands that go nowhere are left out: MAV_CMD %s", path, told)
    return FlightPlan(path, tuple(waypoints), _home(mission.get("plannedHomePosition"), path))


def _simple_items(items: list[Any], where: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield items, and those inside of surveys and scans."""
    for index, item in enumerate(items):
        place = f"{where}[{index}]"
        if not isinstance(item, Mapping):
            raise InvalidInputError(place, json.dumps(item)[:80], "an item of a mission")
        if item.get("type") == "SimpleItem":
            yield place, item
            continue
        inside = item.get("TransectStyleComplexItem")
        if not isinstance(inside, Mapping) or not isinstance(inside.get("Items"), list):
            found = item.get("complexItemType", item.get("type"))
            raise InvalidInputError(place, found, "a simple item, a survey or a corridor scan")
        yield from _simple_items(inside["Items"], f"{place}.Items")


def _waypoint(where: str, item: Mapping[str, Any]) -> Waypoint | None:
    """Return where an item goes; None if it goes nowhere."""
    if _whole(item.get("command"), f"{where}.command", COMMAND) not in POSITIONED:
        return None
    frame, params = _whole(item.get("frame"), f"{where}.frame", FRAME), item.get("params")
    if frame not in AMSL | ABOVE_HOME | ABOVE_GROUND:
        raise InvalidInputError(f"{where}.frame", frame, FRAME)
    if not isinstance(params, list) or len(params) != 7:
        raise InvalidInputError(f"{where}.params", params, "seven numbers")
    lat, lon, altitude = (_number(params[n], f"{where}.params[{n}]") for n in (4, 5, 6))
    if abs(lat) > 90:
        raise InvalidInputError(f"{where}.params[4]", lat, "a latitude from -90 to 90 degrees")
    heading = None if params[3] is None else _number(params[3], f"{where}.params[3]")
    return Waypoint(where, lon, lat, altitude, frame, heading)


def _home(value: Any, path: Path) -> tuple[float, float, float] | None:
    if value is None:
        return None
    field = f"{path}: mission.plannedHomePosition"
    if not isinstance(value, list) or len(value) != 3:
        raise InvalidInputError(field, value, "latitude, longitude and altitude")
    lat, lon, altitude = (_number(each, field) for each in value)
    return lon, lat, altitude


def _whole(value: Any, field: str, expected: str) -> int:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not 0 <= value <= LARGEST_NUMBER or value != int(value):
        raise InvalidInputError(field, value, expected)
    return int(value)


def _number(value: Any, field: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise InvalidInputError(field, value, "a finite number")
    return float(value)
