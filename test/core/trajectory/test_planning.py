"""From the section `drive` to a trajectory, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS, Transformer

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.files.poses import read_pose_table
from oaisys_core.trajectory.files import write_poses, write_trajectory
from oaisys_core.trajectory.planning import DrivePlan, plan_drive, read_waypoints
from oaisys_core.trajectory.trajectory import Trajectory
from oaisys_core.types import FloatArray, Georeference, HeightQuery

DRONE = {"kind": "drone"}


def heights(points_m: FloatArray) -> HeightQuery:
    """A plane 2 m high, 40 m wide, with objects of 0.1 m everywhere."""
    ground_m = np.where(np.abs(points_m[:, :2]).max(axis=1) < 20, 2.0, np.nan)
    return HeightQuery(ground_m, ground_m + 0.1, points_m[:, 2] - ground_m - 0.1)


def planned(**keys: Any) -> DrivePlan:
    section = config_from_mapping({"drive": keys}).drive
    assert section is not None
    return plan_drive(section, heights)


def test_a_rover_drives_on_the_surface_until_the_drive_ends() -> None:
    plan = planned(waypoints_m=[[-5, 0], [5, 0]], duration_s=4.0)
    assert plan.end_s == 4.0
    assert plan.trajectory.end_s > 10
    assert plan.trajectory.positions_m[:, 2] == pytest.approx(2.1)
    assert 1.5 < plan.length_m() < 4.0


def test_waypoints_in_degrees_are_where_proj_puts_them(tmp_path: Path) -> None:
    """On a map of the lunar south pole, whose +y is not true north."""
    system = CRS.from_user_input("+proj=stere +lat_0=-90 +R=1737400 +units=m +type=crs")
    to_degrees = Transformer.from_crs(system, system.geodetic_crs, always_xy=True)
    x0, y0 = 90_000.0, -60_000.0
    here = Georeference(system.to_wkt(), (1.0, 0.0, x0, 0.0, 1.0, y0), -1500.0)
    way_m = [(-5.0, -5.0), (5.0, 0.0), (5.0, 8.0)]
    way_deg = [to_degrees.transform(x0 + x, y0 + y) for x, y in way_m]
    for keys, height_m in (
        ({"waypoints_lon_lat_deg": way_deg}, 2.1),
        ({"waypoints_lon_lat_deg": [(*each, 1509.0) for each in way_deg], "vehicle": DRONE}, 9.0),
    ):
        section = config_from_mapping({"drive": keys}).drive
        assert section is not None
        positions_m = plan_drive(section, heights, (), here).trajectory.positions_m
        assert positions_m[0] == pytest.approx((-5, -5, height_m), abs=1e-3)
        assert positions_m[-1] == pytest.approx((5, 8, height_m), abs=1e-3)
        with pytest.raises(InvalidInputError, match=r"waypoints_lon_lat_deg: .*oaisys place info"):
            plan_drive(section, heights)
    path = tmp_path / "way.csv"
    path.write_text("lon_deg,lat_deg\n" + "".join(f"{lon!r},{lat!r}\n" for lon, lat in way_deg))
    np.testing.assert_allclose(read_waypoints(path, georeference=here)[:, :2], way_m, atol=1e-3)
    with pytest.raises(InvalidInputError, match=r"way\.csv: .*oaisys place info"):
        read_waypoints(path)
    path.write_text("lon_deg,lat_deg,elevation_m\n10,91,5\n")
    with pytest.raises(InvalidInputError, match=r"way\.csv:2: .*lat_deg from -90 to 90"):
        read_waypoints(path, georeference=here)
    with pytest.raises(ConfigError, match="one of waypoints_m, waypoints_lon_lat_deg"):
        config_from_mapping({"drive": {"waypoints_lon_lat_deg": way_deg, "waypoints_m": way_m}})
    with pytest.raises(ConfigError, match=r"waypoints_lon_lat_deg\.1\.1: received 95\.0"):
        config_from_mapping({"drive": {"waypoints_lon_lat_deg": [(46.5, 7.5), (7.6, 95.0)]}})


def test_waypoints_come_from_a_file_and_a_drone_keeps_its_height(tmp_path: Path) -> None:
    way = tmp_path / "way.csv"
    way.write_text("x_m,y_m\n-5,-5\n5,0\n5,8\n")
    drone = {"kind": "drone", "height_above_ground_m": 4.0}
    positions_m = planned(vehicle=drone, waypoints_file=str(way)).trajectory.positions_m
    assert positions_m[0] == pytest.approx((-5, -5, 6))
    assert positions_m[-1] == pytest.approx((5, 8, 6), abs=1e-6)
    way.write_text("x_m,y_m,z_m\n-5,-5,3\n5,0,7\n")
    flight = planned(vehicle={"kind": "drone"}, waypoints_file=str(way)).trajectory
    assert flight.positions_m[-1] == pytest.approx((5, 0, 7), abs=1e-6)


def test_a_file_of_timed_poses_is_followed(tmp_path: Path) -> None:
    made = planned(waypoints_m=[[-5, 0], [5, 3]]).trajectory
    write_trajectory(tmp_path / "way.tum", made)
    again = planned(vehicle={"kind": "file", "path": str(tmp_path / "way.tum")})
    assert (again.trajectory.positions_m == made.positions_m).all()
    assert again.end_s == made.end_s


@pytest.mark.parametrize(
    ("begin_s", "field"), [(-0.5, "trajectory.times_s.0"), (2.0**31, "trajectory.times_s.0")]
)
def test_times_that_stamps_cannot_have_are_refused(
    tmp_path: Path, begin_s: float, field: str
) -> None:
    way = tmp_path / "way.csv"
    write_poses(way, np.array([(begin_s + t, t, 0, 1, 0, 0, 0, 1) for t in (0.0, 1.0, 2.0)]))
    with pytest.raises(InvalidInputError, match=f"{field}: received {begin_s}.*from 0 s"):
        planned(vehicle={"kind": "file", "path": str(way)})


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        ({"waypoints_m": [[0, 0], [30, 0]]}, "a way with all wheels on the stage"),
        ({"waypoints_m": [[0, 0]]}, "two or more waypoints"),
        ({"vehicle": {"kind": "drone"}, "waypoints_m": [[0, 0]]}, r"expected \(x, y, z\)"),
        (
            {
                "vehicle": {"kind": "drone", "height_above_ground_m": 1},
                "waypoints_m": [[0, 0], [0, 25]],
            },
            "waypoints on the stage",
        ),
    ],
)
def test_a_way_that_cannot_be_driven_is_refused(drive: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        planned(**drive)


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        ({}, "one of waypoints_m, waypoints_lon_lat_deg and waypoints_file"),
        ({"vehicle": {"kind": "file", "path": "none.csv"}}, r"drive\.vehicle\.path.*existing file"),
        ({"vehicle": {"kind": "sledge"}, "waypoints_m": [[0, 0]]}, "sledge"),
        ({"vehicle": {"kind": "rover", "axles_m": [1, 1]}, "waypoints_m": [[0, 0]]}, "axles_m"),
        ({"waypoints_m": [[0, 0], [1, 1]], "gravity": "pluto"}, "gravity"),
    ],
)
def test_a_faulty_section_is_refused_with_its_key(drive: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        planned(**drive)


@pytest.mark.parametrize("text", ["x_m,y_m\n1,\n", "x,y\n1,2\n", "x_m,y_m\n", "x_m,y_m\n1,nan\n"])
def test_a_faulty_file_of_waypoints_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "way.csv").write_text(text)
    with pytest.raises(InvalidInputError):
        planned(waypoints_file=str(tmp_path / "way.csv"))


@pytest.mark.parametrize("x_m", [1.1e7, 1e155, 1e308])
def test_waypoints_whose_squares_overflow_are_refused_where_they_are_read(
    tmp_path: Path, x_m: float
) -> None:
    """Lengths of their way were infinite: a spline's own error ended the command."""
    for keys in ({"waypoints_m": [[x_m, 0], [0, 0]]}, {"waypoints_m": [[0, 0, -x_m], [0, 0, 0]]}):
        with pytest.raises(ConfigError, match=r"drive\.waypoints_m\.0\.[02]: received"):
            config_from_mapping({"drive": keys})
    way = tmp_path / "way.csv"
    way.write_text(f"x_m,y_m\n0,0\n{x_m},0\n", encoding="utf-8")
    with pytest.raises(InvalidInputError, match=r"way\.csv:3: received"):
        read_waypoints(way)
    way.write_text(f"t_s,x_m,y_m,z_m,qx,qy,qz,qw\n0,0,{x_m},0,0,0,0,1\n", encoding="utf-8")
    with pytest.raises(InvalidInputError, match=r"way\.csv:2\.position: received"):
        read_pose_table(way)
    with pytest.raises(InvalidInputError, match=r"trajectory\.positions_m\.1: received"):
        Trajectory([0.0, 1.0], [(0, 0, 0), (x_m, 0, 0)], [(0, 0, 0, 1)] * 2)
