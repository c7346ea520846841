"""The bag of a drive, read by a library that is not ours."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from oaisys_core.drive.outputs import DriveDescription, StreamCount
from oaisys_core.types import DriveInstant, ImuInfo, ImuReading, Pose, SimulatorInfo
from oaisys_ros_bridge.bags.drive_bag import DriveBag
from oaisys_ros_bridge.bags.reading import BagReader

OAISYS = Path(sys.executable).with_name("oaisys")
NS_PER_S = 1_000_000_000

MOUNT_M = [0.5, 0.0, 1.5]
CONFIG: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 40, "resolution_px": 65},
    "materials": {"texture_size_px": 16, "mask": {"size_px": 16}},
    "assets": {"rocks": []},
    "sensors": {
        "cameras": [
            {
                "name": "camera",
                "width_px": 32,
                "height_px": 24,
                "fx_px": 27,
                "fy_px": 27,
                "mount_position_m": MOUNT_M,
                "rate_hz": 5.0,
                "modalities": ["rgb", "depth", "semantic_0"],
            }
        ],
        "lidars": [
            {
                "scan": {"kind": "rotating", "channels": 4, "azimuth_steps": 30},
                "rate_hz": 10.0,
                "period_s": 0.1,
            }
        ],
        "imus": [{"name": "imu", "rate_hz": 100.0, "gyroscope_noise_density": 1e-4}],
    },
    "drive": {
        "waypoints_m": [[-6, -4], [0, 0], [6, 1]],
        "duration_s": 1.0,
        "gravity": "moon",
        "odometry_rate_hz": 20.0,
        "odometry_drift": {"position_m_per_sqrt_m": 1.0},
    },
}
TYPES = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/ground_truth/odometry": "nav_msgs/msg/Odometry",
    "/odometry": "nav_msgs/msg/Odometry",
    "/camera/color/image_raw": "sensor_msgs/msg/Image",
    "/camera/color/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/depth/image_raw": "sensor_msgs/msg/Image",
    "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/semantic_0/image_raw": "sensor_msgs/msg/Image",
    "/camera/semantic_0/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/semantic_0/label_info": "vision_msgs/msg/LabelInfo",
    "/camera/semantic_0/labels": "oaisys_msgs/msg/SemanticLabels",
    "/lidar/points": "sensor_msgs/msg/PointCloud2",
    "/imu/data_raw": "sensor_msgs/msg/Imu",
}


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a drive of one second."""
    folder = tmp_path_factory.mktemp("drive")
    config = folder / "drive.yaml"
    config.write_text(yaml.safe_dump(CONFIG))
    out = folder / "out"
    command = [str(OAISYS), "drive", "--config", str(config), "--out", str(out), "--no-report"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return out


@pytest.fixture(scope="module")
def messages(drive: Path) -> dict[str, list[tuple[int, Any]]]:
    """Return the messages of the bag by topic, each with the time at which it was written."""
    found = defaultdict(list)
    with AnyReader([drive / "bag"]) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == TYPES
        for connection, time_ns, data in reader.messages():
            found[connection.topic].append((time_ns, reader.deserialize(data, connection.msgtype)))
    return found


def stamp_ns(stamp: Any) -> int:
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


@pytest.mark.long
def test_the_bag_holds_what_was_due(messages: dict[str, list[Any]]) -> None:
    counts = {topic: len(found) for topic, found in messages.items()}
    images = {topic: 5 for topic in TYPES if topic.endswith(("image_raw", "camera_info"))}
    assert counts == {
        **images,
        "/lidar/points": 10,
        "/imu/data_raw": 100,
        "/odometry": 20,
        "/ground_truth/odometry": 20,
        "/clock": 100,
        "/tf": 100,
        "/tf_static": 1,
        "/camera/semantic_0/label_info": 1,
        "/camera/semantic_0/labels": 1,
    }


def test_stamps_are_simulated_time(messages: dict[str, list[Any]]) -> None:
    for topic, found in messages.items():
        for time_ns, message in found:
            if topic == "/clock":
                stamp = message.clock
            elif topic.startswith("/tf"):
                stamp = message.transforms[0].header.stamp
            else:
                stamp = message.header.stamp
            assert stamp_ns(stamp) == time_ns
    tens = [round(k * NS_PER_S / 10) for k in range(10)]
    assert [time_ns for time_ns, _ in messages["/lidar/points"]] == tens
    transforms = {time_ns for time_ns, _ in messages["/tf"]}
    every = {time_ns for found in messages.values() for time_ns, _ in found}
    assert transforms == every == {time_ns for time_ns, _ in messages["/clock"]}


def test_frames_and_mounts_are_those_of_the_bridge(messages: dict[str, list[Any]]) -> None:
    ((_, static),) = messages["/tf_static"]
    mounts = {t.child_frame_id: (t.header.frame_id, t.transform) for t in static.transforms}
    assert {child: parent for child, (parent, _) in mounts.items()} == {
        "camera_link": "base_link",
        "camera_optical_frame": "camera_link",
        "lidar_link": "base_link",
        "imu_link": "base_link",
    }
    at = mounts["camera_link"][1].translation
    assert [at.x, at.y, at.z] == MOUNT_M
    frames = {
        topic: found[0][1].header.frame_id
        for topic, found in messages.items()
        if "/" in topic[1:] and topic not in ("/tf", "/tf_static")
    }
    assert frames["/camera/depth/image_raw"] == "camera_optical_frame"
    assert frames["/lidar/points"] == "lidar_link"
    assert frames["/imu/data_raw"] == "imu_link"
    assert (frames["/ground_truth/odometry"], messages["/odometry"][0][1].header.frame_id) == (
        "map",
        "odom",
    )


def test_ground_truth_has_its_twist_and_odometry_drifts(
    drive: Path, messages: dict[str, list[Any]]
) -> None:
    table = np.genfromtxt(drive / "odometry.csv", delimiter=",", names=True)
    twists = [m.twist.twist for _, m in messages["/ground_truth/odometry"]]
    assert [t.linear.x for t in twists] == table["vx_m_s"].tolist()
    assert [t.angular.z for t in twists] == table["wz_rad_s"].tolist()
    estimates = np.loadtxt(drive / "odometry.tum")
    poses = [m.pose.pose.position for _, m in messages["/odometry"]]
    assert [(p.x, p.y, p.z) for p in poses] == [tuple(row) for row in estimates[:, 1:4].tolist()]
    assert np.abs(estimates[-1, 1] - table["x_m"][-1]) > 1e-3
    # Transforms lead to the true pose, and pass the drifting one.
    for time_ns, message in messages["/tf"]:
        to_odom, to_base = message.transforms
        assert (to_odom.child_frame_id, to_base.child_frame_id) == ("odom", "base_link")
        place = matrix(to_odom.transform) @ matrix(to_base.transform)
        row = np.flatnonzero(np.isclose(table["t_s"], time_ns / 1e9, atol=1e-6))
        if len(row):
            true = [table[name][row[0]] for name in ("x_m", "y_m", "z_m")]
            assert place[:3, 3] == pytest.approx(true, abs=1e-9)


def matrix(transform: Any) -> np.ndarray:
    t, q = transform.translation, transform.rotation
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    T[:3, 3] = (t.x, t.y, t.z)
    return T


def test_the_imu_measures_what_the_file_says(drive: Path, messages: dict[str, list[Any]]) -> None:
    table = np.loadtxt(drive / "imu/data.csv", delimiter=",", comments="#")
    found = [m for _, m in messages["/imu/data_raw"]]
    assert {m.orientation_covariance[0] for m in found} == {-1.0}
    assert [m.angular_velocity.x for m in found] == table[:, 1].tolist()
    assert [m.linear_acceleration.z for m in found] == table[:, 6].tolist()
    assert found[0].angular_velocity_covariance[0] == pytest.approx(1e-8 * 100)


def test_points_are_those_of_the_file(drive: Path, messages: dict[str, list[Any]]) -> None:
    _, cloud = messages["/lidar/points"][3]
    assert [f.name for f in cloud.fields] == ["x", "y", "z", "intensity", "ring", "time"]
    files = sorted((drive / "batch_0001/lidar").glob("*.pcd"))
    assert len(files) == 10
    assert files[3].read_bytes().endswith(cloud.data.tobytes())


def test_legends_and_mounts_are_latched(drive: Path) -> None:
    topics = BagReader(drive / "bag").topics
    latched = {
        name
        for name, topic in topics.items()
        if topic.qos_profiles[0]["durability"] == "transient_local"
    }
    assert latched == {
        "/tf_static",
        "/camera/semantic_0/labels",
        "/camera/semantic_0/label_info",
    }
    assert {topic.qos_profiles[0]["reliability"] for topic in topics.values()} == {"reliable"}


def test_a_message_that_is_missing_is_counted(tmp_path: Path) -> None:
    imu = ImuInfo("imu", np.eye(4), 10.0)
    info = SimulatorInfo("analytic", "1", 0, "", "preview", (), {}, 1, 0, None, imus=(imu,))
    description = DriveDescription(
        tmp_path, info, {"imu": 3, "odometry": 0}, {"imu": 10.0}, 3, 0.0, 0.3, 0.0, 9.81
    )
    bag = DriveBag(description)
    pose = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    reading = ImuReading("imu", (0.0, 0.0, 0.0), (0.0, 0.0, 9.81))
    for time_ns in (0, 100_000_000):
        still = (0.0, 0.0, 0.0)
        bag.write(DriveInstant(time_ns, pose, still, still, imus=(reading,)))

    counts = bag.finish()

    assert counts["/imu/data_raw"] == StreamCount(due=3, written=2)
    assert counts["/tf_static"] == StreamCount(due=1, written=1)


def test_the_command_says_how_much_it_wrote(drive: Path) -> None:
    assert json.loads((drive / "drive.json").read_text())["recorded"]["imu"] == 100
