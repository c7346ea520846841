"""Poses in bags that the library rosbags wrote, against SciPy and numbers by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation, Slerp

from oaisys_core.errors import InvalidInputError
from oaisys_core.files.poses import PoseSelection, PoseTable, read_pose_table
from oaisys_ros_bridge.bags.recorded.recorded_poses import read_recorded_poses

STORE = get_typestore(Stores.ROS2_JAZZY)
QUATS = Rotation.from_euler("zyx", [[10, 20, 30], [-100, 5, 170], [80, -60, 1]], degrees=True)
POSITIONS_M = [[0.5, -1.25, 2.0], [3.0, 4.0, -5.0], [100.125, 0.0, 1e-3]]
STAMPS_NS = [1403636580838555648, 1403636580843555648, 1403636580848555648]

Rows = Sequence[tuple[str, str, Any]]


def new(name: str, **fields: Any) -> Any:
    """Return a message of a type."""
    return STORE.types[name](**fields)


def header(stamp_ns: int, frame: str = "map") -> Any:
    stamp = new("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(row: int) -> Any:
    x, y, z = POSITIONS_M[row]
    qx, qy, qz, qw = QUATS[row].as_quat()
    return new(
        "geometry_msgs/msg/Pose",
        position=new("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )


def stamped(row: int, frame: str = "map", stamp_ns: int | None = None) -> Any:
    stamp = STAMPS_NS[row] if stamp_ns is None else stamp_ns
    return new("geometry_msgs/msg/PoseStamped", header=header(stamp, frame), pose=pose(row))


def odometry(row: int) -> Any:
    zero = new("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    none = np.zeros(36)
    twist = new("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    return new(
        "nav_msgs/msg/Odometry",
        header=header(STAMPS_NS[row], "odom"),
        child_frame_id="base_link",
        pose=new("geometry_msgs/msg/PoseWithCovariance", pose=pose(row), covariance=none),
        twist=new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=none),
    )


def transform(
    parent: str, child: str, stamp_ns: int, shift: Sequence[float], turn: Rotation
) -> Any:
    x, y, z = map(float, shift)
    qx, qy, qz, qw = turn.as_quat()
    moved = new(
        "geometry_msgs/msg/Transform",
        translation=new("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
        rotation=new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )
    each = new(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp_ns, parent),
        child_frame_id=child,
        transform=moved,
    )
    return new("tf2_msgs/msg/TFMessage", transforms=[each])


def write_bag(folder: Path, rows: Rows, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    """Write (topic, type, message) rows as rosbags does."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        topics: dict[str, Any] = {}
        for number, (topic, kind, message) in enumerate(rows):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(topics[topic], 10**9 + number, STORE.serialize_cdr(message, kind))
    return folder


def check(table: PoseTable, rows: Sequence[int] = (0, 1, 2)) -> None:
    assert table.positions_m.tolist() == [POSITIONS_M[row] for row in rows]
    turned = Rotation.from_quat(table.quats_xyzw).inv() * QUATS[list(rows)]
    assert turned.magnitude() == pytest.approx(0, abs=1e-12)


POSE_STAMPED = "geometry_msgs/msg/PoseStamped"


@pytest.mark.parametrize("is_file", [False, True])
def test_stamped_poses_keep_the_first_of_each_stamp(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, is_file: bool
) -> None:
    rows = [("/goal", POSE_STAMPED, stamped(row)) for row in range(3)]
    rows.insert(1, ("/goal", POSE_STAMPED, stamped(2, stamp_ns=STAMPS_NS[0])))
    path = write_bag(tmp_path / "bag", rows)
    table = read_pose_table(next(path.glob("*.mcap")) if is_file else path)
    check(table)
    assert table.times_s is not None
    assert table.times_s.tolist() == [stamp / 10**9 for stamp in STAMPS_NS]
    assert not table.of_camera
    assert "1 rows have the stamp of an earlier row" in caplog.text


def test_odometry_says_its_frames(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    kind = "nav_msgs/msg/Odometry"
    path = write_bag(tmp_path / "bag", [("/odom", kind, odometry(row)) for row in range(3)])
    check(read_recorded_poses(path, PoseSelection(topic="odom", frame="base_link")))
    assert "poses are in odom, which is taken as map" in caplog.text
    with pytest.raises(InvalidInputError, match=r"frame: received 'imu', .*: base_link"):
        read_recorded_poses(path, PoseSelection(frame="imu"))


def test_the_last_path_and_array_count_and_paths_may_have_no_times(tmp_path: Path) -> None:
    path_kind, array_kind = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseArray"
    paths = [
        new(path_kind, header=header(0), poses=[stamped(row) for row in rows])
        for rows in ([0], [0, 1, 2])
    ]
    alike = [stamped(row, stamp_ns=STAMPS_NS[0]) for row in range(3)]
    array = new(array_kind, header=header(STAMPS_NS[0]), poses=[pose(row) for row in range(3)])
    rows = [
        *(("/path", path_kind, each) for each in paths),
        ("/plan", path_kind, new(path_kind, header=header(0), poses=alike)),
        ("/poses", array_kind, array),
    ]
    bag = write_bag(tmp_path / "bag", rows)
    for topic, timed in (("/path", True), ("/plan", False), ("/poses", False)):
        table = read_pose_table(bag, PoseSelection(topic=topic))
        check(table)
        assert (table.times_s is not None) == timed
    with pytest.raises(InvalidInputError, match=r"topic: received None, .*/path \(nav_msgs"):
        read_pose_table(bag)
    with pytest.raises(InvalidInputError, match="topic: received '/pat'"):
        read_pose_table(bag, PoseSelection(topic="/pat"))


def test_transforms_are_chained_and_interpolated_as_tf2_does(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kind, start = "tf2_msgs/msg/TFMessage", STAMPS_NS[0]
    mount = Rotation.from_euler("y", 30, degrees=True)
    rows = [("/tf_static", kind, transform("base_link", "cam", 0, (0.1, 0.2, 0.3), mount))]
    for index in range(2):  # the correction of a mapper, at 0 and 10 ms
        turn = Rotation.from_euler("z", 40 * index, degrees=True)
        shift = (10.0 * index, 0.0, 0.0)
        rows.append(("/tf", kind, transform("map", "odom", start + index * 10**7, shift, turn)))
    stamps = [start, start + 5 * 10**6, start + 2 * 10**7]
    for row, stamp in enumerate(stamps):
        moved = transform("odom", "base_link", stamp, POSITIONS_M[row], QUATS[row])
        rows.append(("/tf", kind, moved))
    table = read_pose_table(write_bag(tmp_path / "bag", rows), PoseSelection(frame="cam"))
    assert table.times_s is not None
    assert table.times_s.tolist() == [stamp / 10**9 for stamp in stamps[:2]]
    assert "1 poses of cam are left out: odom are not known at their stamps" in caplog.text
    turns = Slerp([0, 1], Rotation.from_euler("z", [[0], [40]], degrees=True))([0.0, 0.5])
    T_odom_cam_m = QUATS[:2].apply([0.1, 0.2, 0.3]) + POSITIONS_M[:2]
    expected_m = turns.apply(T_odom_cam_m) + np.array([[0, 0, 0], [5, 0, 0]])
    assert table.positions_m == pytest.approx(expected_m, abs=1e-9)
    off = Rotation.from_quat(table.quats_xyzw).inv() * turns * QUATS[:2] * mount
    assert off.magnitude() == pytest.approx(0, abs=1e-9)
    with pytest.raises(InvalidInputError, match="frame: received 'can', expected one of"):
        read_pose_table(tmp_path / "bag", PoseSelection(frame="can"))


def test_other_bags_are_refused_with_what_converts_them(tmp_path: Path) -> None:
    rows = [("/goal", POSE_STAMPED, stamped(0))]
    bag = write_bag(tmp_path / "bag", rows, StoragePlugin.SQLITE3)
    for path in (bag, next(bag.glob("*.db3"))):
        with pytest.raises(InvalidInputError, match=r"SQLite bag.*rosbags-convert"):
            read_pose_table(path)
    text = "std_msgs/msg/String"
    other = write_bag(tmp_path / "text", [("/text", text, new(text, data="a"))])
    with pytest.raises(InvalidInputError, match="a bag with poses"):
        read_pose_table(other)
    mixed = [("/goal", POSE_STAMPED, stamped(row, frame)) for row, frame in enumerate("ab")]
    with pytest.raises(InvalidInputError, match=r"received \['a', 'b'\], .*one frame"):
        read_pose_table(write_bag(tmp_path / "mixed", mixed))
    (tmp_path / "none").mkdir()
    with pytest.raises(InvalidInputError, match="a folder is read if it is an MCAP bag"):
        read_pose_table(tmp_path / "none")
