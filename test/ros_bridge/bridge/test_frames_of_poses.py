"""Poses in any frame that the bridge publishes, through every door that takes a stamped pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import simulation_interfaces.srv as srv
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseArray, PoseStamped, Transform, Vector3
from ros_peer import Stage, User, nanoseconds, stamped
from scipy.spatial.transform import Rotation
from served_simulator import FLAT_WORLD
from simulation_interfaces.msg import EntityState, Resource
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from oaisys_core.types import FloatArray, Pose
from oaisys_msgs.action import Drive, Sweep
from oaisys_msgs.msg import SampleInfo
from oaisys_msgs.srv import SetPose
from oaisys_ros_bridge.qos import LATCHED_QOS, NEWEST_QOS, SMALL_MESSAGE_QOS, TF_QOS

pytestmark = pytest.mark.ros

SAMPLES = "oaisys_bridge/sample_info"
CAMERA = {
    **FLAT_WORLD["sensors"]["cameras"][0],
    "mount_position_m": [0.3, -0.2, 0.1],
    "mount_quat_xyzw": Rotation.from_euler("xyz", [8, 35, -12], degrees=True).as_quat().tolist(),
}
WORLD = {
    **FLAT_WORLD,
    "sensors": {
        "cameras": [CAMERA],
        "lidars": [{"scan": {"kind": "raster", "columns": 8, "rows": 4}}],
        "imus": [{"mount_position_m": [0.1, 0.0, 0.3], "mount_quat_xyzw": [0.0, 0.0, 0.6, 0.8]}],
    },
}
PARAMETERS = (
    "map_frame:=rover/map",
    "odom_frame:=rover/odom",
    "base_frame:=rover/base_link",
    "frame_prefix:=rover/",
    "faults.drift_m:=0.3",
    "faults.drift_rad:=0.05",
    "tf_rate:=0.0",
)
FRAMES = [
    "rover/odom",
    "rover/base_link",
    "rover/camera_link",
    "rover/camera_optical_frame",
    "rover/lidar_link",
    "rover/imu_link",
]
START = Pose((1.0, -2.0, 6.0), tuple(Rotation.from_euler("z", 0.7).as_quat().tolist()))
STEP = Pose((0.4, 0.2, 0.1), tuple(Rotation.from_euler("xyz", [0.02, 0.1, 0.3]).as_quat().tolist()))
"""Within any frame."""


@pytest.fixture(scope="module")
def bridged(shared_stage: Stage) -> User:
    """A user of a bridge whose frames have a prefix and whose odometry drifts."""
    server = shared_stage.start_world(WORLD)
    user = shared_stage.user
    user.listen(SampleInfo, SAMPLES, SMALL_MESSAGE_QOS)
    user.listen(TFMessage, "/tf", TF_QOS)
    user.listen(TFMessage, "/tf_static", LATCHED_QOS)
    options = [
        part for each in (f"address:={server.address}", *PARAMETERS) for part in ("-p", each)
    ]
    shared_stage.start_node("bridge", "--ros-args", *options)
    user.wait_until_ready()
    return user


def sample_at(user: User, stamp: Time) -> SampleInfo:
    def found() -> SampleInfo | None:
        known = {nanoseconds(m.transforms[0].header.stamp) for m in user.received["/tf"]}
        infos = (m for m in user.received[SAMPLES] if m.header.stamp == stamp)
        return next(infos, None) if nanoseconds(stamp) in known else None

    sample: SampleInfo = user.wait_until(found)
    return sample


def put(user: User, pose: Pose, frame: str = "map", at: Time | None = None) -> SampleInfo:
    where = stamped(pose, frame)
    where.header.stamp = at or Time()
    answer = user.call(SetPose, "set_pose", SetPose.Request(pose=where))
    assert answer.success, answer.message
    return sample_at(user, answer.stamp)


def matrix(translation: Any, rotation: Any) -> FloatArray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([rotation.x, rotation.y, rotation.z, rotation.w]).as_matrix()
    T[:3, 3] = [translation.x, translation.y, translation.z]
    return T


def of_pose(pose: Any) -> FloatArray:
    return matrix(pose.position, pose.orientation)


def transform_to_map(user: User, frame: str, stamp: Time) -> FloatArray:
    """Chain what was published, as tf2 does."""
    edges = {t.child_frame_id: t for m in user.received["/tf_static"] for t in m.transforms}
    for message in user.received["/tf"]:
        if message.transforms[0].header.stamp == stamp:
            edges |= {t.child_frame_id: t for t in message.transforms}
    T = np.eye(4)
    while frame != "rover/map":
        edge = edges[frame]
        T = matrix(edge.transform.translation, edge.transform.rotation) @ T
        frame = edge.header.frame_id
    return T


def expected(user: User, frame: str, since: SampleInfo) -> FloatArray:
    return transform_to_map(user, frame, since.header.stamp) @ of_pose(stamped(STEP).pose)


def new_sample(user: User, ask: Callable[[], object]) -> SampleInfo:
    before = len(user.received[SAMPLES])
    ask()
    user.wait_until(lambda: len(user.received[SAMPLES]) > before)
    return sample_at(user, user.received[SAMPLES][before].header.stamp)


@pytest.mark.parametrize("frame", FRAMES)
def test_a_pose_is_taken_in_every_frame_of_the_rig(bridged: User, frame: str) -> None:
    first = put(bridged, START)
    wanted = expected(bridged, frame, first)
    second = put(bridged, STEP, frame)
    np.testing.assert_allclose(of_pose(second.rig_pose), wanted, atol=1e-9)
    again = put(bridged, STEP, frame, at=first.header.stamp)  # where the frame was, not is
    np.testing.assert_allclose(of_pose(again.rig_pose), wanted, atol=1e-9)


def test_a_sensor_goes_where_a_pose_in_its_own_frame_is(bridged: User) -> None:
    first = put(bridged, START)
    link = "rover/camera_link"
    wanted = expected(bridged, link, first)
    where = stamped(STEP, link)
    request = SetPose.Request(pose=where, sensor="camera")
    answer = bridged.call(SetPose, "set_pose", request)
    assert answer.success, answer.message
    sample_at(bridged, answer.stamp)
    np.testing.assert_allclose(transform_to_map(bridged, link, answer.stamp), wanted, atol=1e-9)


def trajectory(frame: str, *poses: Pose) -> MultiDOFJointTrajectory:
    points = []
    for second, pose in enumerate(poses):
        p, q = stamped(pose).pose.position, stamped(pose).pose.orientation
        transform = Transform(translation=Vector3(x=p.x, y=p.y, z=p.z), rotation=q)
        since = Duration(sec=second)
        points.append(MultiDOFJointTrajectoryPoint(transforms=[transform], time_from_start=since))
    return MultiDOFJointTrajectory(header=Header(frame_id=frame), points=points)


@pytest.mark.parametrize("door", ["pose", "trajectory"])
def test_commands_come_in_the_rigs_frame(bridged: User, door: str) -> None:
    frame = "rover/base_link"
    first = put(bridged, START)
    wanted = expected(bridged, frame, first)
    message = stamped(STEP, frame) if door == "pose" else trajectory(frame, STEP)
    publisher = bridged.node.create_publisher(type(message), f"command/{door}", NEWEST_QOS)
    bridged.wait_until(publisher.get_subscription_count)
    told = new_sample(bridged, lambda: publisher.publish(message))
    np.testing.assert_allclose(of_pose(told.rig_pose), wanted, atol=1e-9)
    bridged.node.destroy_publisher(publisher)


def test_all_poses_of_a_sweep_are_in_the_frame_as_it_was_at_its_start(bridged: User) -> None:
    frame = "rover/base_link"
    first = put(bridged, START)
    wanted = expected(bridged, frame, first)
    sweep = bridged.action_client(Sweep, "oaisys_bridge/sweep")
    array = PoseArray(header=Header(frame_id=frame), poses=[stamped(STEP).pose] * 2)
    begun = len(bridged.received[SAMPLES])
    goal = bridged.answer(sweep.send_goal_async(Sweep.Goal(poses=array)))
    result = bridged.answer(goal.get_result_async()).result
    assert result.success, result.message
    bridged.wait_until(lambda: len(bridged.received[SAMPLES]) == begun + 2)
    for sample in bridged.received[SAMPLES][begun:]:
        np.testing.assert_allclose(of_pose(sample.rig_pose), wanted, atol=1e-9)


def test_a_drive_begins_in_the_rigs_frame(bridged: User) -> None:
    frame = "rover/base_link"
    first = put(bridged, START)
    far = Pose((1.0, 0.2, 0.1), STEP.quat_xyzw)
    drive = bridged.action_client(Drive, "oaisys_bridge/drive")
    goal = Drive.Goal(trajectory=trajectory(frame, STEP, far), sensors=["odometry"])
    handle = bridged.answer(drive.send_goal_async(goal))
    result = bridged.answer(handle.get_result_async()).result
    assert result.success, result.message
    # The result may overtake it.
    bridged.wait_until(
        lambda: [m for m in bridged.received["/tf"] if m.transforms[0].header.stamp == result.begin]
    )
    begun = transform_to_map(bridged, frame, result.begin)
    np.testing.assert_allclose(begun, expected(bridged, frame, first), atol=1e-9)


def state(frame: str) -> EntityState:
    return EntityState(header=Header(frame_id=frame), pose=stamped(STEP).pose)


def test_entities_are_moved_and_spawned_in_the_cameras_frame(bridged: User) -> None:
    frame = "rover/camera_optical_frame"
    first = put(bridged, START)
    wanted = expected(bridged, frame, first)
    ball = srv.SpawnEntity.Request(
        name="ball",
        entity_resource=Resource(uri="shape:boulder"),
        initial_pose=PoseStamped(header=Header(frame_id=frame), pose=stamped(STEP).pose),
    )
    answer = bridged.call(srv.SpawnEntity, "spawn_entity", ball)
    assert answer.result.result == 1, answer.result.error_message
    for entity in ("ball", "rover/base_link"):
        found = srv.GetEntityState.Request(entity=entity)
        move = srv.SetEntityState.Request(entity=entity, state=state(frame), set_pose=True)
        moved = bridged.call(srv.SetEntityState, "set_entity_state", move)
        assert moved.result.result == 1, moved.result.error_message
        now = bridged.call(srv.GetEntityState, "get_entity_state", found).state
        np.testing.assert_allclose(of_pose(now.pose), wanted, atol=1e-6)
    deleted = bridged.call(
        srv.DeleteEntity, "delete_entity", srv.DeleteEntity.Request(entity="ball")
    )
    assert deleted.result.result == 1


def test_every_door_refuses_other_frames_and_names_those_it_knows(bridged: User) -> None:
    put(bridged, START)
    frame = "rover/camera"
    said = []
    request = SetPose.Request(pose=stamped(STEP, frame))
    said.append(bridged.call(SetPose, "set_pose", request).message)
    move = srv.SetEntityState.Request(entity="camera", state=state(frame), set_pose=True)
    answer = bridged.call(srv.SetEntityState, "set_entity_state", move)
    assert answer.result.result == srv.SetEntityState.Response.INVALID_POSE
    said.append(answer.result.error_message)
    array = PoseArray(header=Header(frame_id=frame), poses=[stamped(STEP).pose])
    for kind, name, goal in (
        (Sweep, "sweep", Sweep.Goal(poses=array)),
        (Drive, "drive", Drive.Goal(trajectory=trajectory(frame, STEP, START))),
    ):
        client = bridged.action_client(kind, f"oaisys_bridge/{name}")
        handle = bridged.answer(client.send_goal_async(goal))
        said.append(bridged.answer(handle.get_result_async()).result.message)
    for words in said:
        assert "header.frame_id: received 'rover/camera'" in words
        for known in ("rover/map", *FRAMES):
            assert known in words


def test_a_time_before_the_first_pose_is_refused(bridged: User) -> None:
    put(bridged, START)
    where = stamped(STEP, "rover/base_link")
    where.header.stamp = Time(sec=1)
    answer = bridged.call(SetPose, "set_pose", SetPose.Request(pose=where))
    assert not answer.success
    assert "pose.header.stamp: received '1.000000000 s', expected 0 for now" in answer.message


def test_numbers_in_another_frame_are_checked_too(bridged: User) -> None:
    put(bridged, START)
    bad = Pose((float("nan"), 0.0, 0.0), STEP.quat_xyzw)
    request = SetPose.Request(pose=stamped(bad, "rover/base_link"))
    answer = bridged.call(SetPose, "set_pose", request)
    assert not answer.success
    assert "pose.pose" in answer.message
