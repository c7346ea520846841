"""What parameters do to the outputs of a real bridge: faults, clouds, compression, its clock."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_peer import Stage, User, nanoseconds
from rosgraph_msgs.msg import Clock
from scipy import stats
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from served_simulator import FLAT_WORLD

from oaisys_core.geometry import pose_looking_down
from oaisys_ros_bridge.clouds import cloud_from_msg
from oaisys_ros_bridge.conversions import image_from_msg
from oaisys_ros_bridge.qos import CLOCK_QOS, SENSOR_QOS

pytestmark = pytest.mark.ros

SIGMA_M = 0.02
STEP_S = 0.5
TOPICS: dict[str, type[Any]] = {
    "camera/depth/image_raw": Image,
    "camera/color/image_raw": Image,
    "camera/color/image_raw/compressed": CompressedImage,
    "camera/depth_registered/points": PointCloud2,
    "odometry": Odometry,
}
STARTED_WITH = {
    "publish_clock": "true",
    "clock_step_s": STEP_S,
    "faults.depth_noise": "gaussian",
    "faults.depth_sigma_m": SIGMA_M,
}


def set_parameters(user: User, **values: Any) -> list[tuple[bool, str]]:
    """Set parameters, in which ``__`` stands for a dot; return whether and why not."""
    parameters = [
        Parameter(name.replace("__", "."), value=value).to_parameter_msg()
        for name, value in values.items()
    ]
    request = SetParameters.Request(parameters=parameters)
    results = user.call(SetParameters, "set_parameters", request).results
    return [(result.successful, result.reason) for result in results]


def sample(user: User, height_m: float) -> dict[str, Any]:
    answer = user.set_pose(pose_looking_down(0.0, 0.0, height_m))
    assert answer.success, answer.message

    def found() -> dict[str, Any] | None:
        # New subscribers are told odometry again, with stamps of its own.
        of_it = {t: m for t in TOPICS for m in user.received[t] if m.header.stamp == answer.stamp}
        return of_it if len(of_it) == len(TOPICS) else None

    messages: dict[str, Any] = user.wait_until(found)
    return messages


@pytest.mark.long
def test_parameters_change_what_is_published_while_it_runs(stage: Stage) -> None:
    user = stage.user
    server = stage.start_world(FLAT_WORLD)
    for topic, kind in TOPICS.items():
        user.listen(kind, topic, SENSOR_QOS)
    user.listen(Clock, "/clock", CLOCK_QOS)
    options = [part for name, value in STARTED_WITH.items() for part in ("-p", f"{name}:={value}")]
    stage.start_node("bridge", "--ros-args", "-p", f"address:={server.address}", *options)
    user.wait_until_ready()

    first = sample(user, 5.0)
    assert nanoseconds(first["odometry"].header.stamp) == STEP_S * 1e9
    told = user.received["/clock"]
    user.wait_until(lambda: any(m.clock == first["odometry"].header.stamp for m in told))
    depth_m = image_from_msg(first["camera/depth/image_raw"])
    assert stats.kstest(((depth_m - 5.0) / SIGMA_M).ravel(), "norm").pvalue > 1e-6
    points_m, colors = cloud_from_msg(first["camera/depth_registered/points"])
    np.testing.assert_array_equal(points_m[..., 2], depth_m)
    np.testing.assert_array_equal(colors, image_from_msg(first["camera/color/image_raw"]))
    assert first["odometry"].pose.pose.position.z == 5.0

    assert all(
        done
        for done, _ in set_parameters(
            user,
            faults__depth_noise="none",
            faults__missing_ratio=0.25,
            faults__drift_m=0.1,
            cloud__stride=2,
            cloud__drop_sky=True,
            compressed__color_format="png",
        )
    )
    second = sample(user, 6.0)
    assert nanoseconds(second["odometry"].header.stamp) == 2 * STEP_S * 1e9
    depth_m = image_from_msg(second["camera/depth/image_raw"])
    missing = np.isnan(depth_m)
    assert stats.binomtest(int(missing.sum()), missing.size, 0.25).pvalue > 1e-6
    np.testing.assert_allclose(depth_m[~missing], 6.0, rtol=1e-6)
    cloud = second["camera/depth_registered/points"]
    assert (cloud.height, cloud.width) == (1, (~missing[::2, ::2]).sum())
    assert 0 < abs(second["odometry"].pose.pose.position.z - 6.0) < 0.6
    assert second["odometry"].pose.covariance[0] == pytest.approx(0.1**2)
    file = second["camera/color/image_raw/compressed"]
    assert file.format == "rgb8; png compressed bgr8"
    pixels = cv2.imdecode(np.frombuffer(file.data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_array_equal(pixels, image_from_msg(second["camera/color/image_raw"]))

    refused = set_parameters(
        user,
        cloud__stride=0,
        compressed__color_format="bmp",
        faults__missing_ratio=1.5,
        publish_clock=False,
    )
    assert [done for done, _ in refused] == [False] * 4
    assert "from 1 to 64 px" in refused[0][1]
    assert "'jpeg', 'png'" in refused[1][1]
    assert "received 1.5" in refused[2][1]
    assert set_parameters(user, publish_points=False, faults__missing_ratio=0.0)[0][0]
    clouds = user.received["camera/depth_registered/points"]
    before = len(clouds)
    answer = user.set_pose(pose_looking_down(0.0, 0.0, 7.0))
    heard = user.received["odometry"]
    user.wait_until(lambda: any(m.header.stamp == answer.stamp for m in heard))
    assert len(clouds) == before
