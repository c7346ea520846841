"""Scans of lidars on their topics: fields, frames, stamps, and what other readers make of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from ros_peer import Stage, stamped
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import PointCloud2, PointField
from served_simulator import FLAT_WORLD
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_looking_down
from oaisys_core.types import LidarScan, point_dtype
from oaisys_msgs.srv import SetPose
from oaisys_ros_bridge.clouds import scan_from_msg, scan_to_msg
from oaisys_ros_bridge.conversions import transform_from_msg
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS

SCAN = {"kind": "rotating", "channels": 8, "azimuth_steps": 90, "elevation_min_deg": -45}
LIDAR = {"scan": SCAN, "mount_position_m": [0.5, 0.0, 0.25], "mount_quat_xyzw": [0, -0.6, 0, 0.8]}
WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "sensors": {**FLAT_WORLD["sensors"], "lidars": [{**LIDAR, "extra_fields": ["label"]}]},
}
VELODYNE = [
    ("x", 0, PointField.FLOAT32),
    ("y", 4, PointField.FLOAT32),
    ("z", 8, PointField.FLOAT32),
    ("intensity", 12, PointField.FLOAT32),
    ("ring", 16, PointField.UINT16),
    ("time", 18, PointField.FLOAT32),
]


def points(count: int, *extra_fields: str) -> LidarScan:
    rng = np.random.default_rng(2)
    data = np.zeros(count, point_dtype(extra_fields))
    for name in data.dtype.names or ():
        data[name] = rng.uniform(0, 100, count)
    return LidarScan("lidar", data, np.eye(4))


@pytest.mark.ros
@pytest.mark.parametrize("extra", [(), ("label",), ("instance", "label")])
@pytest.mark.parametrize("count", [0, 7])
def test_a_scan_comes_back_as_it_was(count: int, extra: tuple[str, ...]) -> None:
    scan = points(count, *extra)
    msg = scan_to_msg(scan, Header(frame_id="lidar_link"))
    assert [(f.name, f.offset, f.datatype) for f in msg.fields][:6] == VELODYNE
    assert (msg.height, msg.width, msg.row_step) == (1, count, msg.point_step * count)
    back = scan_from_msg(msg)
    assert back.dtype == scan.data.dtype
    assert back.tobytes() == scan.data.tobytes()


@pytest.mark.ros
def test_a_cloud_of_another_kind_is_refused() -> None:
    msg = scan_to_msg(points(3), Header())
    msg.fields[4].datatype = PointField.FLOAT32
    with pytest.raises(InvalidInputError, match=r"cloud\.fields"):
        scan_from_msg(msg)
    msg.fields[4].name = "rgb"
    with pytest.raises(InvalidInputError, match=r"cloud\.fields"):
        scan_from_msg(msg)


@pytest.mark.ros
def test_kiss_icp_reads_points_and_times() -> None:
    reader = pytest.importorskip("kiss_icp.tools.point_cloud2", exc_type=ModuleNotFoundError)
    scan = points(50)
    content = serialize_message(scan_to_msg(scan, Header()))
    as_recorded = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(
        content, "sensor_msgs/msg/PointCloud2"
    )
    points_m, times_s = reader.read_point_cloud(as_recorded)
    np.testing.assert_array_equal(points_m, scan.points_m)
    np.testing.assert_array_equal(times_s, scan.data["time"].astype(float))


@pytest.mark.ros
def test_a_sample_brings_its_scan_in_the_frame_of_its_mount(stage: Stage) -> None:
    user = stage.user
    user.listen(PointCloud2, "lidar/points", SENSOR_QOS)
    user.listen(TFMessage, "/tf_static", LATCHED_QOS)
    server = stage.start_world(WORLD)
    stage.start_bridge(server.address)
    user.wait_until_ready()

    pose = stamped(pose_looking_down(0, 0, 5))
    answer = user.call(SetPose, "set_pose", SetPose.Request(pose=pose))

    assert answer.success, answer.message
    user.wait_until(lambda: user.received["lidar/points"])
    msg = user.received["lidar/points"][0]
    assert (msg.header.frame_id, msg.header.stamp) == ("lidar_link", answer.stamp)
    mounts = {t.child_frame_id: t for m in user.received["/tf_static"] for t in m.transforms}
    assert mounts["lidar_link"].header.frame_id == "base_link"
    with server.client() as client:
        scan = client.get_sample(answer.batch_id, answer.sample_id).scans[0]
        info = client.info()
    T_base_lidar = transform_from_msg(mounts["lidar_link"])
    np.testing.assert_allclose(T_base_lidar, info.lidars[0].T_base_lidar, atol=1e-12)
    assert len(scan.data) > 100
    assert scan_from_msg(msg).tobytes() == scan.data.tobytes()
