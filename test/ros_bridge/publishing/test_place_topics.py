"""Where the rig is on Earth, against PROJ on the ground's own numbers and a table of the air."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from pyproj import CRS, Transformer
from ros_peer import Stage
from sensor_msgs.msg import FluidPressure, NavSatFix
from served_simulator import FLAT_WORLD
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import Georeference, Pose
from oaisys_msgs.srv import FromLonLat, ToLonLat
from oaisys_ros_bridge.conversions import transform_from_msg
from oaisys_ros_bridge.publishing.place_topics import (
    air_pressure_pa,
    fix_msg,
    is_on_earth,
    magnetic_field_t,
    map_on_earth,
)
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS

pytestmark = pytest.mark.ros

UTM = CRS.from_epsg(32633)
HERE = Georeference(UTM.to_wkt(), (1.0, 0.0, 500_100.0, 0.0, 1.0, 5_300_200.0), -640.0)


def test_a_fix_is_where_the_projection_has_it() -> None:
    pose = Pose((30.0, -40.0, 12.0), (0.0, 0.0, 0.0, 1.0))
    found = fix_msg(pose, HERE, Header(frame_id="base_link"))
    to_utm = Transformer.from_crs(UTM.geodetic_crs, UTM, always_xy=True)
    x, y = to_utm.transform(found.longitude, found.latitude)
    np.testing.assert_allclose((x, y), (500_130.0, 5_300_160.0), atol=1e-6)
    assert found.altitude == pytest.approx(652.0)
    assert found.header.frame_id == "base_link"


def test_other_bodies_have_no_fix() -> None:
    moon = CRS.from_user_input("+proj=stere +lat_0=-90 +R=1737400 +units=m")
    assert is_on_earth(HERE)
    assert not is_on_earth(Georeference(moon.to_wkt(), HERE.map_to_system, 0.0))


def test_earth_and_map_meet_where_proj_has_them() -> None:
    (found,) = map_on_earth(HERE, "earth", "map", Time(sec=3))
    assert (found.header.frame_id, found.child_frame_id) == ("earth", "map")
    T_earth_map = transform_from_msg(found)
    to_centre = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    for point_m, atol_m in (((0.0, 0.0, 0.0), 1e-6), ((30.0, -40.0, 12.0), 0.03)):
        fix = fix_msg(Pose(point_m, (0.0, 0.0, 0.0, 1.0)), HERE, Header())
        expected_m = to_centre.transform(fix.longitude, fix.latitude, fix.altitude)
        # UTM is 0.04 % short near its middle, and a plane leaves the ellipsoid.
        at_m = T_earth_map @ (*point_m, 1.0)
        np.testing.assert_allclose(at_m[:3], expected_m, rtol=0, atol=atol_m)


def test_there_is_no_earth_above_the_moon_or_without_a_name() -> None:
    moon = CRS.from_user_input("+proj=stere +lat_0=-90 +R=1737400 +units=m")
    there = Georeference(moon.to_wkt(), HERE.map_to_system, 0.0)
    assert map_on_earth(there, "earth", "map", Time()) == []
    assert map_on_earth(None, "earth", "map", Time()) == []
    assert map_on_earth(HERE, "", "map", Time()) == []


@pytest.mark.parametrize(
    ("altitude_m", "expected_pa"),
    [(0.0, 101_325.0), (1000.0, 89_874.6), (5000.0, 54_019.9), (11_000.0, 22_632.0)],
)
def test_pressure_is_that_of_the_standards_table(altitude_m: float, expected_pa: float) -> None:
    assert air_pressure_pa(altitude_m) == pytest.approx(expected_pa, rel=1e-5)


def test_the_magnetic_field_is_that_of_the_models_own_test_values() -> None:
    """The first row of NOAA's test values: 80° N, 0° E, height 0, 2025.0, in nanotesla."""
    north, east, down = np.array((6521.6, 145.9, 54791.5)) * 1e-9
    to_utm = Transformer.from_crs("EPSG:4326", "EPSG:32631", always_xy=True)
    x, y = to_utm.transform(0.0, 80.0)
    there = Georeference(CRS.from_epsg(32631).to_wkt(), (1.0, 0.0, x, 0.0, 1.0, y), 0.0)
    # West of the zone's middle meridian, grid north is west of true north.
    turn = np.arctan(np.tan(np.radians(-3.0)) * np.sin(np.radians(80.0)))
    c, s = np.cos(-turn), np.sin(-turn)
    in_map = (c * east + s * north, c * north - s * east, -down)
    level = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    np.testing.assert_allclose(magnetic_field_t(level, there, 2025.0), in_map, atol=2e-10)
    # Turned by 90° to the left, x looks along the map's y.
    left = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.5**0.5, 0.5**0.5))
    turned = (in_map[1], -in_map[0], in_map[2])
    np.testing.assert_allclose(magnetic_field_t(left, there, 2025.0), turned, atol=2e-10)


@pytest.mark.long
def test_a_bridge_says_where_on_earth_its_world_is(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "hill.tif"
    profile = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": "EPSG:32633"}
    place = Affine(2.0, 0.0, 500_000.0, 0.0, -2.0, 5_300_000.0)
    with rasterio.open(path, "w", **profile, width=33, height=33, transform=place) as file:
        file.write(np.full((33, 33), 800.0, np.float32), 1)
    server = stage.start_world({**FLAT_WORLD, "stage": {"dem": {"file": str(path)}}})
    user = stage.user
    user.listen(FluidPressure, "pressure", SENSOR_QOS)
    user.listen(NavSatFix, "fix", SENSOR_QOS)
    user.listen(TFMessage, "/tf_static", LATCHED_QOS)
    stage.start_bridge(server.address)
    user.wait_until_ready()
    user.wait_until_matched(["/pressure", "/fix"])
    assert user.set_pose(pose_looking_down(4.0, -6.0, 5.0)).success

    user.wait_until(lambda: user.received["fix"] and user.received["pressure"])
    fix, pressure = user.received["fix"][-1], user.received["pressure"][-1]
    to_utm = Transformer.from_crs("EPSG:4326", "EPSG:32633", always_xy=True)
    assert to_utm.transform(fix.longitude, fix.latitude) == pytest.approx(
        (500_037.0, 5_299_961.0), abs=0.05
    )
    assert fix.altitude == pytest.approx(805.0, abs=0.01)
    assert pressure.header == fix.header
    assert pressure.fluid_pressure == pytest.approx(air_pressure_pa(fix.altitude))
    frames = {t.child_frame_id: t for m in user.received["/tf_static"] for t in m.transforms}
    T_earth_map = transform_from_msg(frames["map"])
    to_centre = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    expected_m = to_centre.transform(fix.longitude, fix.latitude, fix.altitude)
    at_m = T_earth_map @ (4.0, -6.0, 5.0, 1.0)
    np.testing.assert_allclose(at_m[:3], expected_m, rtol=0, atol=0.01)

    lon_lat = user.call(
        ToLonLat, "to_lon_lat", ToLonLat.Request(points=[Point(x=4.0, y=-6.0, z=5.0)])
    )
    assert lon_lat.success, lon_lat.message
    there = (lon_lat.longitude[0], lon_lat.latitude[0], lon_lat.elevation[0])
    assert there == pytest.approx((fix.longitude, fix.latitude, fix.altitude), abs=1e-9)
    assert CRS.from_wkt(lon_lat.reference_system).to_epsg() == 32633
    asked = FromLonLat.Request(longitude=[there[0]], latitude=[there[1]])
    for elevation, z_m in (([805.0], 5.0), ([], 0.0)):
        asked.elevation = elevation
        back = user.call(FromLonLat, "from_lon_lat", asked)
        assert back.success, back.message
        (point,) = back.points
        assert (point.x, point.y, point.z) == pytest.approx((4.0, -6.0, z_m), abs=1e-3)
        assert back.header.frame_id == "map"
    asked.latitude = [91.0]
    assert "latitude from -90 to 90" in user.call(FromLonLat, "from_lon_lat", asked).message
    asked.latitude = []
    assert "1 longitudes, 0 latitudes" in user.call(FromLonLat, "from_lon_lat", asked).message
