"""What is published of a sample: each modality in its encoding, each camera's info."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry, Path
from ros_peer import User
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from oaisys_core.geometry import (
    T_LINK_OPTICAL,
    pixel_rays,
    pose_to_matrix,
    transform,
)
from oaisys_core.types import (
    Frame,
    PinholeIntrinsics,
    Pose,
    Provenance,
    Sample,
    SensorInfo,
    SimulatorInfo,
    modality_spec,
)
from oaisys_msgs.msg import SampleInfo, SemanticLabels
from oaisys_ros_bridge.clouds import cloud_from_msg
from oaisys_ros_bridge.conversions import image_from_msg, transform_from_msg
from oaisys_ros_bridge.motion import odometry_from_msg
from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.publishing import sensor_topics
from oaisys_ros_bridge.publishing.sample_publisher import SamplePublisher
from oaisys_ros_bridge.qos import (
    LATCHED_HISTORY_QOS,
    LATCHED_QOS,
    SENSOR_QOS,
    SMALL_MESSAGE_QOS,
    TF_QOS,
)

pytestmark = pytest.mark.ros

BENT = PinholeIntrinsics(8, 6, 7.5, 7.25, 3.5, 2.25, (-0.1, 0.02, 1e-3, -2e-3, 0.0))
ENCODINGS = {
    "rgb": "rgb8",
    "depth": "32FC1",
    "range": "32FC1",
    "normal": "32FC3",
    "flow": "32FC2",
    "albedo": "rgb8",
    "disparity": "32FC1",
    "instance": "32SC1",
    "semantic_0": "16UC1",
    "semantic_7": "16UC1",
}
TOPICS = {"rgb": "color", "depth": "depth"}
RIG = Pose((1.0, 2.0, 9.0), (0.0, 0.0, 0.0, 1.0))
HOW = Provenance(1, 2, "a" * 64, "analytic", "0.1.0", "standard", 4)
DEFAULTS = {row.name: row.default for row in BRIDGE}


def publish(publisher: SamplePublisher, sample: Sample, stamp: Time) -> None:
    publication = publisher.begin(sample.outline, stamp)
    for frame in sample.frames:
        publication.add(frame)
    publication.finish(sample)


def pair() -> SimulatorInfo:
    T_right = transform(np.eye(3), (0.0, -0.2, 0.0)) @ T_LINK_OPTICAL
    sensors = (
        SensorInfo("left", BENT, T_LINK_OPTICAL, tuple(ENCODINGS)),
        SensorInfo("right", BENT, T_right, tuple(ENCODINGS), 0.2),
    )
    extent_m = (-9.0, -9.0, 9.0, 9.0)
    return SimulatorInfo(
        "analytic", "0.1.0", 1, "a" * 64, "standard", sensors, {1: "sand"}, 1, 0, extent_m
    )


def image_of(modality: str) -> np.ndarray[Any, Any]:
    dtype, channels = modality_spec(modality)
    shape = (6, 8) if channels == 1 else (6, 8, channels)
    image = np.random.default_rng(3).integers(1, 200, shape).astype(dtype)
    if modality == "flow":
        image[0] = np.nan
    return image


def sample_of(info: SimulatorInfo) -> Sample:
    frames = [
        Frame(s.name, m, image_of(m), s.intrinsics, s.T_base_camera)
        for s in info.sensors
        for m in s.modalities
    ]
    return Sample(1, 5, RIG, tuple(frames), 0.1, HOW)


def test_every_modality_of_every_camera_is_published(user: User) -> None:
    info = pair()
    publisher = SamplePublisher(user.node, info, lambda: DEFAULTS)
    topics: dict[str, type[Any]] = {}
    for name in ("left", "right"):
        for modality in ENCODINGS:
            topics[f"{name}/{TOPICS.get(modality, modality)}/image_raw"] = Image
        topics |= {f"{name}/{each}/camera_info": CameraInfo for each in ("color", "depth")}
        topics[f"{name}/depth_registered/points"] = PointCloud2
        for level in (0, 7):
            user.listen(SemanticLabels, f"{name}/semantic_{level}/labels", LATCHED_QOS)
    for topic, kind in topics.items():
        user.listen(kind, topic, SENSOR_QOS)
    for topic in topics:
        user.wait_until(partial(user.node.count_subscribers, topic))
    sample, stamp = sample_of(info), Time(sec=7)

    def arrived() -> bool:
        publish(publisher, sample, stamp)
        labels = [f"{name}/semantic_7/labels" for name in ("left", "right")]
        return all(user.received[topic] for topic in [*topics, *labels])

    user.wait_until(arrived)
    for name in ("left", "right"):
        for modality, encoding in ENCODINGS.items():
            (msg, *_) = user.received[f"{name}/{TOPICS.get(modality, modality)}/image_raw"]
            assert (msg.encoding, msg.header.stamp.sec) == (encoding, 7)
            frame = name if modality in ("depth", "range") else "left"
            assert msg.header.frame_id == f"{frame}_optical_frame"
            np.testing.assert_array_equal(image_from_msg(msg), image_of(modality))
        (camera, *_) = user.received[f"{name}/depth/camera_info"]
        assert list(camera.d) == list(BENT.distortion)
        assert camera.p[3] == 0
        (camera, *_) = user.received[f"{name}/color/camera_info"]
        assert camera.p[3] == (0 if name == "left" else -7.5 * 0.2)
        (cloud, *_) = user.received[f"{name}/depth_registered/points"]
        expected_m = pixel_rays(BENT) * image_of("depth")[..., None]
        np.testing.assert_allclose(cloud_from_msg(cloud)[0], expected_m, rtol=1e-6)
    assert user.received["left/semantic_7/labels"][0].labels[0].name == "sand"


def test_a_sample_at_which_nobody_rendered_is_told_of(user: User) -> None:
    info = pair()
    publisher = SamplePublisher(user.node, info, lambda: DEFAULTS)
    topic = f"{user.node.get_name()}/sample_info"
    user.listen(SampleInfo, topic, SMALL_MESSAGE_QOS)
    empty = Sample(1, 6, RIG, (), 0.0, HOW)

    def arrived() -> bool:
        publish(publisher, empty, Time(sec=8))
        return bool(user.received[topic])

    user.wait_until(arrived)
    (msg, *_) = user.received[topic]
    assert (msg.sample_id, list(msg.sensors)) == (6, [])


def test_nothing_is_made_that_nobody_listens_to(
    user: User, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    for name in [name for name in vars(sensor_topics) if name.endswith("_msg")]:
        make = getattr(sensor_topics, name)

        def spy(*args: Any, name: str = name, make: Any = make) -> Any:
            made.append(name)
            return make(*args)

        monkeypatch.setattr(sensor_topics, name, spy)
    info = pair()
    publisher = SamplePublisher(user.node, info, lambda: DEFAULTS)
    made.clear()  # fixed transforms
    publish(publisher, sample_of(info), Time(sec=1))
    assert made == []

    user.listen(CompressedImage, "left/depth/image_raw/compressedDepth", SENSOR_QOS)
    user.listen(CompressedImage, "right/color/image_raw/compressed", SENSOR_QOS)
    for topic in list(user.received)[-2:]:
        user.wait_until(partial(user.node.count_subscribers, topic))

    def arrived() -> bool:
        made.clear()
        publish(publisher, sample_of(info), Time(sec=2))
        return all(user.received[topic] for topic in list(user.received)[-2:])

    user.wait_until(arrived)
    assert sorted(made) == ["depth_to_compressed_msg", "image_to_compressed_msg"]


COMPRESSED = {
    "rgb": "rgb8; png compressed bgr8",
    "albedo": "rgb8; png compressed bgr8",
    "semantic_0": "16UC1; png compressed ",
    "semantic_7": "16UC1; png compressed ",
    "instance": "32SC1; png compressed bgra8",
    "depth": "32FC1; compressedDepth png",
    "range": "32FC1; compressedDepth png",
}


def test_images_go_out_compressed_as_parameters_say(user: User) -> None:
    info = pair()
    values = {**DEFAULTS, "compressed.color_format": "png", "compressed.depth_max_m": 300.0}
    publisher = SamplePublisher(user.node, info, lambda: values)
    topics = {
        modality: f"left/{TOPICS.get(modality, modality)}/image_raw/compressed"
        for modality in COMPRESSED
    }
    topics["as image_transport has it"] = "left/depth/image_raw/compressedDepth"
    for topic in topics.values():
        user.listen(CompressedImage, topic, SENSOR_QOS)
    for topic in topics.values():
        user.wait_until(partial(user.node.count_subscribers, topic))

    def arrived() -> bool:
        publish(publisher, sample_of(info), Time(sec=7))
        return all(user.received[topic] for topic in topics.values())

    user.wait_until(arrived)
    for modality, image_format in COMPRESSED.items():
        (msg, *_) = user.received[topics[modality]]
        assert msg.format == image_format
        assert (msg.header.stamp.sec, msg.header.frame_id) == (7, "left_optical_frame")
        if "compressedDepth" not in image_format:
            file = np.frombuffer(msg.data, np.uint8)
            found = cv2.imdecode(file, cv2.IMREAD_UNCHANGED)
            truth = image_of(modality)
            if modality == "instance":
                found = found.view("<u4")[..., 0]
            elif truth.ndim == 3:
                found = found[..., ::-1]
            np.testing.assert_array_equal(found, truth)
    (depth, *_), (same, *_) = (user.received[topics[m]] for m in ("depth", list(topics)[-1]))
    assert depth == same


def test_depth_clouds_and_ranges_suffer_the_same_and_nothing_else_does(user: User) -> None:
    info = pair()
    values = {
        **DEFAULTS,
        "faults.depth_noise": "gaussian",
        "faults.depth_sigma_m": 2.0,
        "faults.missing_ratio": 0.2,
        "faults.min_depth_m": 30.0,
        "faults.max_depth_m": 170.0,
    }
    publisher = SamplePublisher(user.node, info, lambda: values)
    sample = sample_of(info)
    lengths = np.linalg.norm(pixel_rays(BENT), axis=-1)
    frames = [
        replace(f, data=(image_of("depth") * lengths).astype(np.float32))
        if f.modality == "range"
        else f
        for f in sample.frames
    ]
    sample = replace(sample, frames=tuple(frames))
    names = ("depth", "range", "color", "instance", "normal")
    topics = {name: f"left/{name}/image_raw" for name in names}
    topics |= {"right": "right/depth/image_raw"}
    for topic in topics.values():
        user.listen(Image, topic, SENSOR_QOS)
    points = "left/depth_registered/points"
    user.listen(PointCloud2, points, SENSOR_QOS)
    for topic in [*topics.values(), points]:
        user.wait_until(partial(user.node.count_subscribers, topic))

    def arrived() -> bool:
        publish(publisher, sample, Time(sec=7))
        return all(user.received[topic] for topic in [*topics.values(), points])

    user.wait_until(arrived)
    found = {name: image_from_msg(user.received[topic][0]) for name, topic in topics.items()}
    again = image_from_msg(user.received[topics["depth"]][-1])
    np.testing.assert_array_equal(again, found["depth"])
    assert not np.array_equal(found["right"], found["depth"])
    seen = np.isfinite(found["depth"])
    error_m = (found["depth"] - image_of("depth"))[seen]
    assert np.isnan(found["depth"]).any()
    assert 0.5 < error_m.std() < 4.0
    assert (np.abs(found["depth"][seen] - 100) <= 70).all()
    np.testing.assert_allclose(found["range"], found["depth"] * lengths, rtol=1e-5)
    points_m, _ = cloud_from_msg(user.received[points][0])
    np.testing.assert_array_equal(points_m[..., 2][seen], found["depth"][seen])
    assert np.isnan(points_m[~seen]).all()
    for modality, name in (("rgb", "color"), ("instance", "instance"), ("normal", "normal")):
        np.testing.assert_array_equal(found[name], image_of(modality))


def sample_at(sample_id: int, pose: Pose = RIG, batch_id: int = 1) -> Sample:
    info = pair()
    return replace(sample_of(info), sample_id=sample_id, rig_pose=pose, batch_id=batch_id)


def test_odometry_drifts_beside_the_truth(user: User) -> None:
    values = dict(DEFAULTS)
    publisher = SamplePublisher(user.node, pair(), lambda: values)
    topics: dict[str, type[Any]] = {"odometry": Odometry, "ground_truth/odometry": Odometry}
    for topic, kind in topics.items():
        user.listen(kind, topic, SENSOR_QOS)
    user.listen(TFMessage, "/tf", TF_QOS)
    for topic in [*topics, "/tf"]:
        user.wait_until(partial(user.node.count_subscribers, topic))

    def poses_at(sample_id: int) -> dict[str, Any]:
        stamp = Time(sec=sample_id)

        def found() -> dict[str, Any] | None:
            publish(publisher, sample_at(sample_id), stamp)
            of_it = {
                topic: [m for m in user.received[topic] if m.header.stamp == stamp]
                for topic in topics
            }
            of_it["/tf"] = [
                m for m in user.received["/tf"] if m.transforms[0].header.stamp == stamp
            ]
            return {t: m[0] for t, m in of_it.items()} if all(of_it.values()) else None

        poses: dict[str, Any] = user.wait_until(found)
        return poses

    exact = poses_at(50)
    assert exact["odometry"] == exact["ground_truth/odometry"]
    assert not exact["odometry"].pose.covariance.any()
    assert exact["odometry"].header.frame_id == "map"
    assert frames_of(exact["/tf"]) == [("map", "base_link")]
    for topic in topics:  # a rig that jumps has no velocity that anybody knows
        assert (np.diag(exact[topic].twist.covariance.reshape(6, 6)) == 1e6).all()

    values |= {"faults.drift_m": 0.02, "faults.drift_rad": 0.001}
    moved = poses_at(51)
    assert moved["ground_truth/odometry"].pose == exact["ground_truth/odometry"].pose
    assert frames_of(moved["/tf"]) == [("map", "odom"), ("odom", "base_link")]
    found = [transform_from_msg(transform) for transform in moved["/tf"].transforms]
    np.testing.assert_allclose(found[0] @ found[1], pose_to_matrix(RIG), atol=1e-12)
    assert moved["odometry"].header.frame_id == "odom"
    drifted = pose_to_matrix(odometry_from_msg(moved["odometry"]))
    np.testing.assert_allclose(drifted, found[1], rtol=0, atol=1e-12)
    covariance = moved["odometry"].pose.covariance.reshape(6, 6)
    np.testing.assert_allclose(np.diag(covariance), [50 * 0.02**2] * 3 + [50 * 0.001**2] * 3)
    off_m = np.subtract(position(moved["odometry"].pose.pose.position), RIG.position_m)
    assert (np.abs(off_m) > 0).all()
    assert (np.abs(off_m) < 6 * np.sqrt(50) * 0.02).all()

    values["faults.tf_drifts"] = True
    lost = poses_at(52)
    believed = position(lost["odometry"].pose.pose.position)
    assert frames_of(lost["/tf"]) == [("map", "odom"), ("odom", "base_link")]
    at_odom, at_base = (position(t.transform.translation) for t in lost["/tf"].transforms)
    assert at_odom == (0.0, 0.0, 0.0)
    assert at_base == pytest.approx(believed, abs=1e-12)
    assert position(lost["ground_truth/odometry"].pose.pose.position) == RIG.position_m


def frames_of(message: TFMessage) -> list[tuple[str, str]]:
    return [(t.header.frame_id, t.child_frame_id) for t in message.transforms]


def position(vector: Any) -> tuple[float, float, float]:
    return (vector.x, vector.y, vector.z)


def drawn_until(paths: list[Path], arrays: list[MarkerArray], second: int) -> bool:
    newest = paths[-1].header, arrays[-1].markers[-1].header
    return all(header.stamp.sec == second for header in newest)


def test_path_and_viewpoints_grow_forget_the_oldest_and_begin_anew_with_a_world(
    user: User,
) -> None:
    values = {**DEFAULTS, "path.length": 4, "viewpoints.count": 6, "viewpoints.depth_m": 2.0}
    publisher = SamplePublisher(user.node, pair(), lambda: values)
    for i in range(1, 4):  # nobody is there yet
        publish(publisher, sample_at(i, Pose((float(i), 0.0, 9.0), RIG.quat_xyzw)), Time(sec=i))

    user.listen(Path, "path", LATCHED_QOS)
    user.listen(MarkerArray, "viewpoints", LATCHED_HISTORY_QOS)
    paths, arrays = user.received["path"], user.received["viewpoints"]
    user.wait_until(lambda: paths and arrays)
    assert [p.pose.position.x for p in paths[-1].poses] == [1, 2, 3]
    assert (paths[-1].header.frame_id, paths[-1].poses[0].header.stamp.sec) == ("map", 1)
    everything = arrays[-1].markers
    assert everything[0].action == Marker.DELETEALL
    assert [(m.ns, m.action) for m in everything[1:]] == [("left", 0), ("right", 0)] * 3
    numbers = [m.id for m in everything[1:]]
    assert len(set(numbers)) == 6
    assert max(p.z for m in everything[1:] for p in m.points) == pytest.approx(2.0)

    for i in (4, 5):
        publish(publisher, sample_at(i, Pose((float(i), 0.0, 9.0), RIG.quat_xyzw)), Time(sec=i))
        user.wait_until(partial(drawn_until, paths, arrays, i))
    assert [p.pose.position.x for p in paths[-1].poses] == [2, 3, 4, 5]
    gone = [(m.ns, m.id) for m in arrays[-1].markers if m.action == Marker.DELETE]
    assert gone == [("left", numbers[2]), ("right", numbers[3])]
    added = [m for m in arrays[-1].markers if m.action == Marker.ADD]
    assert [m.header.stamp.sec for m in added] == [5, 5]

    publish(publisher, sample_at(1, batch_id=2), Time(sec=6))
    user.wait_until(lambda: len(paths[-1].poses) == 1)
    user.wait_until(lambda: [m.action for m in arrays[-1].markers] == [Marker.ADD] * 2)
    assert [m.action for m in arrays[-2].markers] == [Marker.DELETEALL]


def test_frames_of_robots_that_share_transforms_have_prefixes(user: User) -> None:
    values = {**DEFAULTS, "frame_prefix": "a/", "map_frame": "a/map", "base_frame": "a/base_link"}
    user.listen(TFMessage, "/tf_static", LATCHED_QOS)
    publisher = SamplePublisher(user.node, pair(), lambda: values)

    (mounts,) = user.wait_until(lambda: user.received["/tf_static"])

    edges = {(t.header.frame_id, t.child_frame_id) for t in mounts.transforms}
    expected = {("a/base_link", f"a/{n}_link") for n in ("left", "right")}
    expected |= {(f"a/{n}_link", f"a/{n}_optical_frame") for n in ("left", "right")}
    assert edges == expected
    publisher.destroy()
