"""The bridge between a real server and a user: what is published, refused and survived."""

from __future__ import annotations

import json
import math
from typing import Any

import cv2
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from ros_peer import Stage, User, nanoseconds, stamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from served_simulator import FLAT_WORLD
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import FloatArray, Pose
from oaisys_core.world.modules.sensors import START_HEIGHT_M
from oaisys_msgs.msg import SampleInfo, SemanticLabels
from oaisys_msgs.srv import SetMetadata, SetPose, StepBatch
from oaisys_ros_bridge.clouds import cloud_from_msg
from oaisys_ros_bridge.conversions import image_from_msg
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS, TF_QOS

pytestmark = pytest.mark.ros

BALL_M = np.array([1.0, -0.5, 1.2])
RADIUS_M = 0.7
BALL_ID = 20
WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "assets": {
        "rocks": [],
        "primitives": [
            {
                "shape": "sphere",
                "radius_m": RADIUS_M,
                "position_m": BALL_M.tolist(),
                "label": "ball",
                "semantic_id": BALL_ID,
            }
        ],
    },
    "sensors": {
        "cameras": [
            {  # nothing symmetric, so that no mistake cancels out
                "width_px": 80,
                "height_px": 60,
                "fx_px": 65.0,
                "fy_px": 70.0,
                "cx_px": 35.25,
                "cy_px": 32.5,
                "mount_position_m": [0.3, -0.2, 0.1],
                "mount_quat_xyzw": Rotation.from_euler("xyz", [8, 5, -12], degrees=True)
                .as_quat()
                .tolist(),
            }
        ]
    },
}
REPEATED = "ground_truth/odometry"
"""It tells where the rig is between two samples, too."""
STAMPED_TOPICS: dict[str, type[Any]] = {
    "camera/color/image_raw": Image,
    "camera/color/camera_info": CameraInfo,
    "camera/depth/image_raw": Image,
    "camera/depth/camera_info": CameraInfo,
    "camera/depth_registered/points": PointCloud2,
    "camera/semantic_0/image_raw": Image,
    "camera/instance/image_raw": Image,
    REPEATED: Odometry,
    "oaisys_bridge/sample_info": SampleInfo,
}


@pytest.fixture(scope="module")
def shared_user(shared_stage: Stage) -> User:
    """A user who hears everything of a bridge in the world with a ball."""
    server = shared_stage.start_world(WORLD)
    listen(shared_stage.user)
    shared_stage.start_bridge(server.address)
    shared_stage.user.wait_until_ready()
    return shared_stage.user


@pytest.fixture
def bridged(shared_user: User) -> User:
    """That user, with a new batch and nothing received but what is latched."""
    step_batch(shared_user)
    for topic in (*STAMPED_TOPICS, "/tf"):
        shared_user.received[topic].clear()
    return shared_user


def step_batch(user: User, **fields: Any) -> StepBatch.Response:
    return user.call(StepBatch, "step_batch", StepBatch.Request(**{"seed": -1, **fields}))


def listen(user: User) -> None:
    for topic, kind in STAMPED_TOPICS.items():
        user.listen(kind, topic, SENSOR_QOS)
    user.listen(TFMessage, "/tf", TF_QOS)
    user.listen(TFMessage, "/tf_static", LATCHED_QOS)
    user.listen(SemanticLabels, "camera/semantic_0/labels", LATCHED_QOS)


def tf_at(user: User, stamp: Any) -> TFMessage | None:
    """Return the rig's transforms of a stamp, once they have been received."""
    found = (tf for tf in user.received["/tf"] if tf.transforms[0].header.stamp == stamp)
    return next(found, None)


def all_of_sample(user: User, stamp: Any) -> dict[str, Any]:
    """Wait for every message of a stamp and return them by topic."""

    def found() -> dict[str, Any] | None:
        messages = {}
        for topic in STAMPED_TOPICS:
            for message in user.received[topic]:
                if message.header.stamp == stamp:
                    messages[topic] = message
        if tf := tf_at(user, stamp):
            messages["/tf"] = tf
        return messages if len(messages) == len(STAMPED_TOPICS) + 1 else None

    found_messages: dict[str, Any] = user.wait_until(found)
    return found_messages


def lookup(user: User, tf: TFMessage, target: str, source: str) -> tuple[Rotation, FloatArray]:
    """Chain transforms by their names, with SciPy: x_target = R x_source + t."""
    edges = {t.child_frame_id: t for t in tf.transforms}
    for message in user.received["/tf_static"]:
        edges.update({t.child_frame_id: t for t in message.transforms})
    R, t = Rotation.identity(), np.zeros(3)
    frame = source
    while frame != target:
        transform = edges[frame].transform
        q, p = transform.rotation, transform.translation
        R_parent = Rotation.from_quat([q.x, q.y, q.z, q.w])
        t = R_parent.apply(t) + np.array([p.x, p.y, p.z])
        R = R_parent * R
        frame = edges[frame].header.frame_id
    return R, t


def views_of_the_ball() -> list[Pose]:
    rng = np.random.default_rng(5)
    poses = []
    for azimuth in np.linspace(0, 2 * np.pi, 20, endpoint=False):
        distance_m, height_m = rng.uniform(4, 7), rng.uniform(2, 6)
        offset = np.array([np.cos(azimuth), np.sin(azimuth), 0]) * distance_m
        eye = BALL_M + offset + [0, 0, height_m - BALL_M[2]]
        poses.append(pose_looking_at(eye, BALL_M + rng.uniform(-0.3, 0.3, 3)))
    return poses


def ball_depth_m(K: FloatArray, R: Rotation, eye_m: FloatArray, pixel: FloatArray) -> float:
    """Return the planar depth of the ball along a pixel's ray: the quadratic's nearer root."""
    ray = R.apply([(pixel[0] - K[0, 2]) / K[0, 0], (pixel[1] - K[1, 2]) / K[1, 1], 1.0])
    a, b = ray @ ray, ray @ (eye_m - BALL_M)
    c = (eye_m - BALL_M) @ (eye_m - BALL_M) - RADIUS_M**2
    return float((-b - math.sqrt(b * b - a * c)) / a)


def outline_m(eye_m: FloatArray) -> FloatArray:
    """Return points of the ball's outline: the circle where its tangents from the eye touch it."""
    distance_m = np.linalg.norm(BALL_M - eye_m)
    axis = (BALL_M - eye_m) / distance_m
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)[:, None]
    rim = np.cos(angles) * side + np.sin(angles) * np.cross(axis, side)
    circle_radius_m = RADIUS_M * math.sqrt(1 - (RADIUS_M / distance_m) ** 2)
    points_m: FloatArray = BALL_M - axis * RADIUS_M**2 / distance_m + rim * circle_radius_m
    return points_m


def test_a_ball_is_seen_where_transforms_and_camera_info_say(bridged: User) -> None:
    last_ns = 0
    for pose in views_of_the_ball():
        answer = bridged.set_pose(pose)
        assert answer.success, answer.message
        assert nanoseconds(answer.stamp) > last_ns
        last_ns = nanoseconds(answer.stamp)
        sample = all_of_sample(bridged, answer.stamp)

        info = sample["camera/depth/camera_info"]
        K, D = info.k.reshape(3, 3), np.array(info.d)
        R, eye_m = lookup(bridged, sample["/tf"], "map", info.header.frame_id)
        rvec, tvec = R.inv().as_rotvec(), -R.inv().apply(eye_m)
        outline = cv2.projectPoints(outline_m(eye_m), rvec, tvec, K, D)[0][:, 0]
        center = cv2.projectPoints(BALL_M[None], rvec, tvec, K, D)[0][0, 0]

        instance = image_from_msg(sample["camera/instance/image_raw"])
        semantic = image_from_msg(sample["camera/semantic_0/image_raw"])
        expected = np.zeros(instance.shape, np.uint8)
        cv2.fillPoly(expected, [np.rint(outline * 256).astype(np.int32)], 1, shift=8)
        edge = cv2.dilate(expected, np.ones((3, 3))) - cv2.erode(expected, np.ones((3, 3)))
        assert expected.sum() > 50
        np.testing.assert_array_equal((instance > 0)[edge == 0], (expected > 0)[edge == 0])
        np.testing.assert_array_equal(semantic[edge == 0] == BALL_ID, expected[edge == 0] > 0)

        pixel = np.rint(center).astype(int)
        depth_m = image_from_msg(sample["camera/depth/image_raw"])
        seen_m = depth_m[pixel[1], pixel[0]]
        assert seen_m == pytest.approx(ball_depth_m(K, R, eye_m, pixel), abs=2e-4)

        points_m, colors = cloud_from_msg(sample["camera/depth_registered/points"])
        in_map_m = R.apply(points_m[pixel[1], pixel[0]]) + eye_m
        assert np.linalg.norm(in_map_m - BALL_M) == pytest.approx(RADIUS_M, abs=2e-4)
        rgb = image_from_msg(sample["camera/color/image_raw"])
        np.testing.assert_array_equal(colors, rgb)
        np.testing.assert_array_equal(np.isnan(points_m[..., 2]), np.isinf(depth_m))

        p = sample["ground_truth/odometry"].pose.pose.position
        assert (p.x, p.y, p.z) == pytest.approx(pose.position_m)


def test_messages_name_their_frames_and_say_how_to_repeat_them(bridged: User) -> None:
    answer = bridged.set_pose(pose_looking_down(0.0, 0.0, 5.0))
    sample = all_of_sample(bridged, answer.stamp)

    optical = "camera_optical_frame"
    assert {m.header.frame_id for t, m in sample.items() if t.startswith("camera/")} == {optical}
    assert sample["/tf"].transforms[0].header.frame_id == "map"
    assert sample["/tf"].transforms[0].child_frame_id == "base_link"
    odometry = sample["ground_truth/odometry"]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
    encodings = {t: m.encoding for t, m in sample.items() if isinstance(m, Image)}
    assert encodings == {
        "camera/color/image_raw": "rgb8",
        "camera/depth/image_raw": "32FC1",
        "camera/semantic_0/image_raw": "16UC1",
        "camera/instance/image_raw": "32SC1",
    }
    info = sample["oaisys_bridge/sample_info"]
    assert (info.batch_id, info.sample_id) == (answer.batch_id, answer.sample_id)
    assert answer.batch_id >= info.sample_id == 1
    assert info.backend == "analytic"
    assert len(info.config_sha256) == 64
    assert (info.device, info.from_cache) == ("cpu", False)
    assert [sensor.sensor for sensor in info.sensors] == ["camera"]
    np.testing.assert_array_equal(info.sensors[0].k, sample["camera/depth/camera_info"].k)
    R, eye_m = lookup(bridged, sample["/tf"], "map", optical)
    p, q = info.sensors[0].pose.position, info.sensors[0].pose.orientation
    np.testing.assert_allclose([p.x, p.y, p.z], eye_m, atol=1e-9)
    assert (Rotation.from_quat([q.x, q.y, q.z, q.w]) * R.inv()).magnitude() < 1e-9
    legend = {
        entry.id: entry.name for entry in bridged.received["camera/semantic_0/labels"][-1].labels
    }
    assert legend[BALL_ID] == "ball"
    again = bridged.set_pose(pose_looking_down(0.0, 0.0, 5.0))
    assert all_of_sample(bridged, again.stamp)["oaisys_bridge/sample_info"].from_cache


REFUSED: list[tuple[Pose, dict[str, Any], str]] = [
    (Pose((0.0, 0.0, math.nan), (0.0, 0.0, 0.0, 1.0)), {}, "position"),
    (Pose((0.0, math.inf, 3.0), (0.0, 0.0, 0.0, 1.0)), {}, "position"),
    (Pose((0.0, 0.0, 3.0), (0.0, 0.0, 0.0, 0.0)), {}, "unit quaternion"),
    (Pose((0.0, 0.0, 3.0), (0.0, 0.0, 0.0, 1.5)), {}, "unit quaternion"),
    (Pose((0.0, 0.0, -2.0), (0.0, 0.0, 0.0, 1.0)), {}, "clearance"),
    (Pose((500.0, 0.0, 3.0), (0.0, 0.0, 0.0, 1.0)), {}, "stage"),
    (Pose((0.0, 0.0, 3.0), (0.0, 0.0, 0.0, 1.0)), {"sensor": "lidar"}, "one of camera"),
    (Pose((0.0, 0.0, 3.0), (0.0, 0.0, 0.0, 1.0)), {"modalities": ["smell"]}, "depth, instance"),
    (Pose((0.0, 0.0, 3.0), (0.0, 0.0, 0.0, 1.0)), {"frame": "elsewhere"}, "frame_id"),
]


def test_what_cannot_be_rendered_is_refused_and_nothing_is_published(bridged: User) -> None:
    for pose, fields, reason in REFUSED:
        rest = {name: value for name, value in fields.items() if name != "frame"}
        where = stamped(pose, fields.get("frame", "map"))
        answer = bridged.call(SetPose, "set_pose", SetPose.Request(pose=where, **rest))
        assert not answer.success
        assert reason in answer.message
        assert (answer.batch_id, answer.sample_id) == (0, 0)

    answer = bridged.set_pose(pose_looking_down(0.0, 0.0, 5.0))

    assert (answer.success, answer.sample_id) == (True, 1)
    all_of_sample(bridged, answer.stamp)
    assert {len(bridged.received[topic]) for topic in STAMPED_TOPICS if topic != REPEATED} == {1}
    # The start of the batch is repeated in time: never, if all of this took less than a period.
    heights_m = {m.pose.pose.position.z for m in bridged.received[REPEATED]}
    assert heights_m - {START_HEIGHT_M} == {5.0}


def test_a_sensor_can_be_put_somewhere_and_modalities_chosen(bridged: User) -> None:
    pose = pose_looking_at((3.0, 2.0, 4.0), BALL_M)

    answer = bridged.set_pose(pose, sensor="camera", modalities=["depth"])

    assert answer.success, answer.message
    bridged.wait_until(lambda: bridged.received["oaisys_bridge/sample_info"])
    assert bridged.received["oaisys_bridge/sample_info"][0].sensors[0].modalities == ["depth"]
    # The pose before is repeated in time: a topic's last message may be of it.
    tf = bridged.wait_until(lambda: tf_at(bridged, answer.stamp))
    R, position_m = lookup(bridged, tf, "map", "camera_link")
    np.testing.assert_allclose(position_m, pose.position_m, atol=1e-9)
    assert (R * Rotation.from_quat(pose.quat_xyzw).inv()).magnitude() < 1e-9
    bridged.wait_until(lambda: bridged.received["camera/depth/image_raw"])
    assert not bridged.received["camera/color/image_raw"]
    assert not bridged.received["camera/instance/image_raw"]


def test_batches_and_metadata_are_set_or_refused_with_the_reason(bridged: User) -> None:
    def set_metadata(module: str, text: str) -> SetMetadata.Response:
        request = SetMetadata.Request(module=module, metadata_json=text)
        return bridged.call(SetMetadata, "set_metadata", request)

    for module, text, reason in (
        ("weather", "{}", "one of asset"),
        ("environment", "{", "JSON"),
        ("environment", "[1]", "JSON object"),
        ("sensor", '{"pose": [0]}', "set_pose"),
    ):
        answer = set_metadata(module, text)
        assert (answer.success, reason in answer.message) == (False, True), answer.message

    # What the simulator refuses at the next sample does not spoil those after it.
    assert set_metadata("environment", '{"sun_colour": 1}').success
    spoilt = bridged.set_pose(pose_looking_down(0, 0, 5))
    assert not spoilt.success
    assert "sun_colour" in spoilt.message
    answer = bridged.set_pose(pose_looking_down(0, 0, 5))
    first = answer.batch_id
    assert answer.success

    dark = json.dumps({"sun_strength_w_m2": 0.0, "sky_strength": 0.0})
    assert set_metadata("environment", dark).success
    # A view that is refused keeps the metadata that waits.
    assert not bridged.set_pose(pose_looking_down(0, 0, 5), modalities=["smell"]).success
    rgb = all_of_sample(bridged, bridged.set_pose(pose_looking_down(0, 0, 5)).stamp)
    assert image_from_msg(rgb["camera/color/image_raw"]).max() == 0
    headlight = {"frame": "base_link", "position_m": [0.0, 0.0, 0.5], "strength_w": 500.0}
    assert set_metadata("environment", json.dumps({"lamps": {"front": headlight}})).success
    rgb = all_of_sample(bridged, bridged.set_pose(pose_looking_down(0, 0, 5)).stamp)
    assert image_from_msg(rgb["camera/color/image_raw"]).max() > 30

    assert not step_batch(bridged, seed=-5).success
    assert "metadata_json.sky" in step_batch(bridged, metadata_json='{"sky": 1}').message
    second, third = step_batch(bridged), step_batch(bridged, seed=7, reuse_stage=True)
    assert (second.success, second.batch_id) == (True, first + 1)
    assert (third.success, third.batch_id) == (True, first + 2)
    answer = bridged.set_pose(pose_looking_down(0, 0, 5))
    assert (answer.batch_id, answer.sample_id) == (first + 2, 1)


def test_of_many_commands_the_newest_wins(bridged: User) -> None:
    commands = bridged.node.create_publisher(PoseStamped, "command/pose", 1)
    bridged.wait_until(lambda: commands.get_subscription_count() == 1)
    heights_m = np.linspace(3.0, 12.0, 40)

    for height_m in heights_m:
        commands.publish(stamped(pose_looking_down(0.0, 0.0, float(height_m))))
    samples = bridged.received["oaisys_bridge/sample_info"]
    bridged.wait_until(lambda: samples and samples[-1].rig_pose.position.z == heights_m[-1])

    rendered_m = [sample.rig_pose.position.z for sample in samples]
    assert rendered_m == sorted(set(rendered_m))
    stamps = [nanoseconds(sample.header.stamp) for sample in samples]
    assert stamps == sorted(set(stamps))


@pytest.mark.long
def test_sensors_of_a_rig_have_topics_and_frames_of_their_own(stage: Stage) -> None:
    user = stage.user
    mounted = {"right": [0.0, -0.1, 0.0], "left": [0.0, 0.1, 0.0]}
    camera = FLAT_WORLD["sensors"]["cameras"][0]
    cameras = [{**camera, "name": n, "mount_position_m": p} for n, p in mounted.items()]
    server = stage.start_world({**FLAT_WORLD, "sensors": {"cameras": cameras}})
    for name in mounted:
        user.listen(Image, f"{name}/depth/image_raw", SENSOR_QOS)
    user.listen(TFMessage, "/tf", TF_QOS)
    user.listen(TFMessage, "/tf_static", LATCHED_QOS)
    stage.start_bridge(server.address)
    user.wait_until_ready()

    answer = user.set_pose(pose_looking_down(1.0, 2.0, 5.0))

    for name in mounted:
        images = user.received[f"{name}/depth/image_raw"]
        user.wait_until(images.__len__)
        assert images[0].header.stamp == answer.stamp
        assert images[0].header.frame_id == f"{name}_optical_frame"
    # The start pose comes before, and is repeated.
    transforms = user.wait_until(
        lambda: next(
            (m for m in user.received["/tf"] if m.transforms[0].header.stamp == answer.stamp), None
        )
    )
    eyes_m = {n: lookup(user, transforms, "map", f"{n}_optical_frame")[1] for n in mounted}
    # Looking down at yaw 0, the rig's left is the map's +y.
    np.testing.assert_allclose(eyes_m["left"], [1.0, 2.1, 5.0], atol=1e-9)
    np.testing.assert_allclose(eyes_m["right"], [1.0, 1.9, 5.0], atol=1e-9)
