"""The drive action as its users see it: every measurement on its topic, with simulated stamps."""

from __future__ import annotations

import json
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from driven_world import DRIVEN_WORLD, DUE, TOPIC_OF_SENSOR
from geometry_msgs.msg import Quaternion, Transform, Vector3
from nav_msgs.msg import Odometry
from rclpy.action.client import ClientGoalHandle
from ros_peer import NodeProcess, Stage, User, messages_of_samples, nanoseconds
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Imu, PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from waiting import PATIENCE_S, START_PATIENCE_S, wait_until

from oaisys_core.geometry import pose_looking_down
from oaisys_msgs.action import Drive
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.conversions import transform_from_msg
from oaisys_ros_bridge.motion import imu_from_msg, twist_from_msg
from oaisys_ros_bridge.qos import CLOCK_QOS, LATCHED_QOS, MOTION_QOS, SMALL_MESSAGE_QOS

pytestmark = pytest.mark.ros

SAMPLES = "oaisys_bridge/sample_info"
TYPES: dict[str, type[Any]] = {
    "front": Image,
    "side": Image,
    "lidar": PointCloud2,
    "imu": Imu,
    "odometry": Odometry,
}


class Driver:
    """A client of the action, with the feedback that it got."""

    def __init__(self, user: User) -> None:
        self._user = user
        self._client = user.action_client(Drive, "oaisys_bridge/drive")
        self.feedback: list[Drive.Feedback] = []

    def begin(self, goal: Drive.Goal | None = None) -> ClientGoalHandle:
        sent = self._client.send_goal_async(
            goal or Drive.Goal(), lambda message: self.feedback.append(message.feedback)
        )
        handle = self._user.answer(sent)
        assert handle.accepted
        return handle

    def result(self, goal: ClientGoalHandle) -> tuple[int, Drive.Result]:
        answer = self._user.answer(goal.get_result_async())
        return answer.status, answer.result

    def drive(self, goal: Drive.Goal | None = None) -> tuple[int, Drive.Result]:
        return self.result(self.begin(goal))


def bridged(stage: Stage, *parameters: str, **env: str) -> User:
    server = stage.start_world(DRIVEN_WORLD, **env)
    user = stage.user
    for sensor, topic in TOPIC_OF_SENSOR.items():
        user.listen(TYPES[sensor], topic, MOTION_QOS)
    user.listen(SampleInfo, SAMPLES, SMALL_MESSAGE_QOS)
    user.listen(TFMessage, "/tf", MOTION_QOS)
    user.listen(TFMessage, "/tf_static", LATCHED_QOS)
    options = [
        part for each in (f"address:={server.address}", *parameters) for part in ("-p", each)
    ]
    stage.start_node("bridge", "--ros-args", *options)
    return user


def upwards(heights_m: list[float], frame: str = "map") -> MultiDOFJointTrajectory:
    """One second from each height to the next, above (1, 2)."""
    rotation = Quaternion(w=1.0)
    points = [
        MultiDOFJointTrajectoryPoint(
            transforms=[Transform(translation=Vector3(x=1.0, y=2.0, z=z), rotation=rotation)],
            time_from_start=Duration(sec=second),
        )
        for second, z in enumerate(heights_m)
    ]
    return MultiDOFJointTrajectory(header=Header(frame_id=frame), points=points)


def has_length(messages: list[Any], length: int) -> bool:
    return len(messages) == length


def counts_of(result: Drive.Result) -> dict[str, int]:
    assert all(each.made <= each.due for each in result.sensors)
    return {each.sensor: each.made for each in result.sensors}


def odometry_of_drives(user: User) -> list[Odometry]:
    """Return the true odometry without the poses of a rig that stands: those have no twist."""
    received = user.received["ground_truth/odometry"]
    return [message for message in received if twist_from_msg(message) is not None]


def stamp_ns(message: Any) -> int:
    """Of a message with a header, or of its first transform."""
    first = message.transforms[0] if isinstance(message, TFMessage) else message
    return nanoseconds(first.header.stamp)


def test_a_drive_publishes_every_measurement_at_its_simulated_time(stage: Stage) -> None:
    user = bridged(stage, "publish_clock:=true", "clock_step_s:=0.5")
    user.listen(Clock, "/clock", CLOCK_QOS)
    user.wait_until_ready()
    driver = Driver(user)

    status, result = driver.drive()

    assert (status, result.success, result.message) == (GoalStatus.STATUS_SUCCEEDED, True, "")
    assert counts_of(result) == {each.sensor: each.due for each in result.sensors} == DUE
    published = {each.topic: each.count for each in result.topics}
    # The start pose comes before.
    for topic in ("ground_truth/odometry", "/tf"):
        messages = user.received[topic]
        messages[:] = [m for m in messages if stamp_ns(m) >= nanoseconds(result.begin)]
    for sensor, topic in TOPIC_OF_SENSOR.items():
        assert published[f"/{topic}"] == DUE[sensor]
        received = user.received[topic]
        user.wait_until(partial(has_length, received, DUE[sensor]))
        stamps_ns = [nanoseconds(message.header.stamp) for message in received]
        rate_hz = {"front": 10, "side": 4, "lidar": 5, "imu": 100, "odometry": 20}[sensor]
        begin_ns = nanoseconds(result.begin)
        assert begin_ns == 5 * 10**8  # a step after 0
        assert stamps_ns == [begin_ns + k * 10**9 // rate_hz for k in range(DUE[sensor])]
    user.wait_until(lambda: len(user.received["/tf"]) == published["/tf"] == 100)
    poses = {
        nanoseconds(m.transforms[0].header.stamp): transform_from_msg(m.transforms[0])
        for m in user.received["/tf"]
    }
    infos = user.received[SAMPLES]
    assert published["/oaisys_bridge/sample_info"] == len(infos) == 12
    assert {nanoseconds(info.header.stamp) for info in infos} <= poses.keys()
    assert [s.sensor for s in infos[0].sensors] == ["front", "side", "lidar"]
    assert list(infos[0].sensors[2].modalities) == ["points"]

    moving = user.received["ground_truth/odometry"][-1]
    at = moving.pose.pose.position
    assert poses[nanoseconds(moving.header.stamp)][:3, 3] == pytest.approx([at.x, at.y, at.z])
    twist = twist_from_msg(moving)
    assert twist is not None
    assert 0.1 < twist.velocity_m_s[0] <= 1.0  # it accelerates with 0.5 m/s^2
    imu = user.received["imu/data_raw"][0]
    assert (imu.header.frame_id, imu.orientation_covariance[0]) == ("imu_link", -1)
    assert np.linalg.norm(imu_from_msg(imu)[1]) == pytest.approx(1.624, abs=5e-3)
    mounts = {t.child_frame_id for m in user.received["/tf_static"] for t in m.transforms}
    assert {"imu_link", "lidar_link", "front_optical_frame"} <= mounts

    clock_ns = [nanoseconds(message.clock) for message in user.received["/clock"]]
    assert all(a <= b for a, b in pairwise(clock_ns))
    assert driver.feedback[0].duration == 1.0
    assert all(a.elapsed < b.elapsed for a, b in pairwise(driver.feedback))
    # Time goes on from where the drive has ended.
    answer = user.set_pose(pose_looking_down(0.0, 0.0, 5.0))
    assert nanoseconds(answer.stamp) == begin_ns + 99 * 10**7 + 5 * 10**8


@pytest.mark.long
def test_a_drive_is_cancelled_in_the_middle_of_a_render_and_keeps_what_it_has(
    stage: Stage,
) -> None:
    slow_from_sample_3 = {"OAISYS_FAULT": "slow:240@3", "OAISYS_TEST_BUILD": "1"}
    user = bridged(stage, **slow_from_sample_3)
    user.wait_until_ready()
    driver = Driver(user)
    goal = Drive.Goal(
        trajectory=upwards([8.0, 9.0, 11.0]),
        sensors=["front", "odometry"],
        drive_json=json.dumps({"odometry_drift": {"scale_error": 0.5}}),
    )
    handle = driver.begin(goal)
    # Odometry of 0.15 s goes before the sample of 0.2 s, which the fault holds up.
    user.wait_until(lambda: (len(user.received[SAMPLES]), len(odometry_of_drives(user))) == (2, 4))

    status, result = driver.drive(goal)
    assert (status, result.success) == (GoalStatus.STATUS_ABORTED, False)
    assert "another goal of ~/drive runs" in result.message
    user.answer(handle.cancel_goal_async())
    status, result = driver.result(handle)

    assert (status, result.success) == (GoalStatus.STATUS_CANCELED, False)
    assert result.message == "cancelled"
    assert {each.sensor: each.due for each in result.sensors} == {"front": 20, "odometry": 40}
    made = counts_of(result)
    assert made == {"front": 2, "odometry": 4}

    status, result = driver.drive(goal)
    assert (status, result.message) == (GoalStatus.STATUS_SUCCEEDED, "")
    assert counts_of(result) == {"front": 20, "odometry": 40}
    # The path through odom leads to the true pose.
    user.wait_until(lambda: len(odometry_of_drives(user)) == made["odometry"] + 40)
    newest = odometry_of_drives(user)[-1]
    last = user.wait_until(
        lambda: next(
            (
                message.transforms
                for message in user.received["/tf"]
                if message.transforms[0].header.stamp == newest.header.stamp
            ),
            None,
        )
    )
    assert [t.child_frame_id for t in last] == ["odom", "base_link"]
    truth = newest.pose.pose.position
    T_map_base = transform_from_msg(last[0]) @ transform_from_msg(last[1])
    assert T_map_base[:3, 3] == pytest.approx([truth.x, truth.y, truth.z])
    assert last[1].transform.translation.z - 8.0 == pytest.approx(1.5 * (truth.z - 8.0))
    heights_m = [m.pose.pose.position.z for m in odometry_of_drives(user)[-40:]]
    assert (heights_m[0], max(heights_m)) == (8.0, heights_m[-1])
    assert nanoseconds(user.set_pose(pose_looking_down(0, 0, 9)).stamp) > nanoseconds(result.begin)


@pytest.mark.long
def test_a_drive_that_is_refused_or_fails_says_where(stage: Stage) -> None:
    user = bridged(stage)
    user.wait_until_ready()
    driver = Driver(user)
    for goal, reason in (
        (Drive.Goal(trajectory=upwards([8.0, 9.0], frame="world")), "received 'world'"),
        (Drive.Goal(trajectory=upwards([8.0])), "at least two poses"),
        (Drive.Goal(drive_json="[1]"), "drive_json: received '[1]', expected a JSON object"),
        (Drive.Goal(drive_json=json.dumps({"gravity": "venus"})), "drive.gravity"),
        (Drive.Goal(sensors=["fron"]), "did you mean front?"),
        (Drive.Goal(trajectory=upwards([8.0, 3.0, -20.0])), "clearance"),
    ):
        status, result = driver.drive(goal)
        assert (status, result.success) == (GoalStatus.STATUS_ABORTED, False), reason
        assert reason in result.message
    made = counts_of(result)
    assert 0 < made["front"] < 20
    user.wait_until(lambda: len(user.received[TOPIC_OF_SENSOR["front"]]) == made["front"])


@pytest.mark.long
def test_the_program_that_drives_once_waits_for_the_recorder_which_gets_all_that_was_due(
    stage: Stage, tmp_path: Path
) -> None:
    """1000 inertial measurements in each second, as fast as they can be published."""
    server = stage.start_world(
        {**DRIVEN_WORLD, "sensors": {**DRIVEN_WORLD["sensors"], "imus": [{"rate_hz": 1000.0}]}}
    )
    program = stage.start_node("drive", "--wait-for-recorder", "--sensors", "lidar", "odometry")

    def start_recorder(bag: Path) -> NodeProcess:
        recorder = stage.start_node("recorder", "--out", str(bag))
        wait_until(lambda: "recording: " in recorder.log.read_text(), START_PATIENCE_S)
        return recorder

    # It records all that there is, which is nothing of the bridge.
    recorder = start_recorder(tmp_path / "early")
    stage.start_bridge(server.address)

    assert program.process.wait(START_PATIENCE_S) == 0, program.log.read_text()

    assert "lidar: 5 of 5 measurements" in program.log.read_text()
    assert recorder.end() == 0
    recorded = messages_of_samples(tmp_path / "early")
    assert (recorded["/lidar/points"], recorded["/ground_truth/odometry"]) == (5, 20)
    refused = stage.start_node("drive", "--drive-json", '{"gravity": "venus"}')
    assert refused.process.wait(PATIENCE_S) == 1
    assert "drive: drive.gravity" in refused.log.read_text()
    assert "Traceback" not in refused.log.read_text()

    user = stage.user
    recorder = start_recorder(tmp_path / "bag")
    user.wait_until_ready()
    user.wait_until_matched(["/imu/data_raw", "/tf", "/ground_truth/odometry", "/lidar/points"])
    status, result = Driver(user).drive(Drive.Goal(trajectory=upwards([8.0, 9.0, 10.0])))

    assert (status, result.message) == (GoalStatus.STATUS_SUCCEEDED, "")
    assert counts_of(result)["imu"] == 2000
    assert recorder.end() == 0
    recorded = messages_of_samples(tmp_path / "bag")
    # Path and viewpoints are published once more for a subscriber that is new.
    repeated = {"/path", "/viewpoints"}
    published = {e.topic: e.count for e in result.topics if e.topic not in repeated}
    assert {topic: recorded[topic] for topic in published} == published
