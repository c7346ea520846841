"""Messages of vision_msgs and stereo_msgs, over a wire, against brute force and closed forms."""

from __future__ import annotations

from functools import partial
from typing import Any

import cv2
import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from ros_peer import User
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage
from vision_msgs.msg import Detection2DArray, LabelInfo

from oaisys_core.geometry import T_LINK_OPTICAL, transform
from oaisys_core.types import (
    Frame,
    PinholeIntrinsics,
    Pose,
    Provenance,
    Sample,
    SceneObject,
    SensorInfo,
)
from oaisys_core.types import SimulatorInfo as Info
from oaisys_ros_bridge.conversions import image_from_msg, transform_from_msg
from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.publishing.sample_publisher import SamplePublisher
from oaisys_ros_bridge.publishing.vision import boxes_msg, detections_msg
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS

LENS = PinholeIntrinsics(40, 30, 50.0, 50.0, 19.5, 14.5)
BASELINE_M = 0.2
LEGEND = "stereo_left/semantic_0/label_info"
MODALITIES = ("disparity", "instance", "semantic_0", "depth")
DEPTH_M = np.linspace(1.0, 9.0, 1200, dtype=np.float32).reshape(30, 40)


def objects() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Overlapping shapes, one of them in two parts, and labels that differ at their rims."""
    ids, labels = np.zeros((30, 40), np.uint32), np.full((30, 40), 1, np.uint16)
    ids[2:9, 3:17], labels[2:9, 4:17] = 7, 20
    ids[5:20, 10:12], labels[5:20, 10:12] = 70_000, 21
    ids[29, 39], labels[29, 39] = 9, 0
    ids[0, 0] = 7
    return ids, labels


def test_boxes_are_those_of_the_pixels() -> None:
    ids, labels = objects()
    found = detections_msg(ids, labels, Header(frame_id="left_optical_frame"))
    assert [each.id for each in found.detections] == ["7", "9", "70000"]
    for each in found.detections:
        shown = np.argwhere(ids == int(each.id))
        centre, size = each.bbox.center.position, (each.bbox.size_y, each.bbox.size_x)
        assert (centre.y, centre.x) == tuple((shown.min(axis=0) + shown.max(axis=0)) / 2)
        assert size == tuple(np.ptp(shown, axis=0) + 1)
        (result,) = each.results
        values, counts = np.unique(labels[ids == int(each.id)], return_counts=True)
        assert result.hypothesis.class_id == str(values[counts.argmax()])
        assert each.header.frame_id == "left_optical_frame"


def test_an_image_without_objects_has_no_boxes() -> None:
    empty = detections_msg(np.zeros((4, 4), np.uint32), None, Header())
    assert list(empty.detections) == []
    (alone,) = detections_msg(np.full((4, 4), 3, np.uint32), None, Header()).detections
    assert (alone.bbox.size_x, alone.bbox.center.position.x, list(alone.results)) == (4, 1.5, [])


LOW_M, HIGH_M = np.array([-0.4, -0.3, 0.0]), np.array([0.8, 0.5, 0.6])
"""A box whose centre is not the object's origin."""


def thing(instance_id: int, position_m: Any, turn: Rotation) -> SceneObject:
    x, y, z = np.asarray(position_m, float).tolist()
    qx, qy, qz, qw = turn.as_quat().tolist()
    low, high = LOW_M.tolist(), HIGH_M.tolist()
    pose = Pose((x, y, z), (qx, qy, qz, qw))
    nowhere = (0.0, 0.0, 0.0)
    own_box = ((low[0], low[1], low[2]), (high[0], high[1], high[2]))
    return SceneObject(
        instance_id, "a_1", "object", "", "rock", 20, pose, 2.0, nowhere, nowhere, *own_box
    )


def test_boxes_in_space_project_to_where_the_objects_corners_are() -> None:
    """Corners: here by rotation matrices in `map`, there by OpenCV from the message alone."""
    signs = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    eye_m, look = np.array([-3.0, 1.0, 2.0]), Rotation.from_euler("yzx", [0.4, -0.3, 0.1])
    R_map_optical = look.as_matrix() @ [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T_map_camera = transform(R_map_optical, eye_m)
    turns = Rotation.from_euler("zyx", [(0.3, 0.2, -0.9), (2.0, -0.4, 0.1)])
    places_m = np.array([(3.0, -0.5, 0.2), (4.0, 0.6, -0.3)])
    things = [thing(40 - i, places_m[i], turns[i]) for i in (0, 1)]
    found = boxes_msg(things, T_map_camera, Header(frame_id="camera_optical_frame"))
    assert [each.id for each in found.detections] == ["39", "40"]
    K = np.array([[LENS.fx_px, 0, LENS.cx_px], [0, LENS.fy_px, LENS.cy_px], [0, 0, 1.0]])
    for each, i in zip(found.detections, (1, 0), strict=True):
        corners_m = LOW_M + signs * (HIGH_M - LOW_M)
        in_map_m = corners_m @ turns[i].as_matrix().T + places_m[i]
        in_camera = (in_map_m - eye_m) @ R_map_optical
        expected_px = (in_camera / in_camera[:, 2:]) @ K.T
        centre, size = each.bbox.center, each.bbox.size
        q, p = centre.orientation, centre.position
        rotation = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_rotvec()
        box_m = (signs - 0.5) * [size.x, size.y, size.z]
        found_px, _ = cv2.projectPoints(box_m, rotation, np.array([p.x, p.y, p.z]), K, None)
        np.testing.assert_allclose(found_px[:, 0], expected_px[:, :2], atol=1e-6)
        (result,) = each.results
        assert result.hypothesis.class_id == "20"
        origin = result.pose.pose.position
        expected_m = (places_m[i] - eye_m) @ R_map_optical
        np.testing.assert_allclose([origin.x, origin.y, origin.z], expected_m, atol=1e-9)


def rig() -> Info:
    T_right = T_LINK_OPTICAL @ transform(np.eye(3), (BASELINE_M, 0.0, 0.0))
    sensors = (
        SensorInfo("stereo_left", LENS, T_LINK_OPTICAL, MODALITIES),
        SensorInfo("stereo_right", LENS, T_right, MODALITIES, BASELINE_M),
    )
    extent_m = (-9.0, -9.0, 9.0, 9.0)
    labels = {1: "sand", 20: "rock"}
    return Info("analytic", "1", 1, "a" * 64, "standard", sensors, labels, 1, 0, extent_m)


def test_readers_of_both_packages_get_what_the_images_say(user: User) -> None:
    info = rig()
    defaults = {row.name: row.default for row in BRIDGE}
    publisher = SamplePublisher(user.node, info, lambda: defaults)
    topics: dict[str, type[Any]] = {
        "stereo_left/disparity/disparity_image": DisparityImage,
        "stereo_left/detections": Detection2DArray,
        "stereo_right/transform": TransformStamped,
    }
    user.listen(LabelInfo, LEGEND, LATCHED_QOS)
    for topic, kind in topics.items():
        user.listen(kind, topic, SENSOR_QOS)
    for topic in topics:
        user.wait_until(partial(user.node.count_subscribers, topic))
    ids, labels = objects()
    disparity_px = np.float32(LENS.fx_px * BASELINE_M) / DEPTH_M
    disparity_px[0] = 0.0
    images = {
        "disparity": disparity_px,
        "instance": ids,
        "semantic_0": labels,
        "depth": DEPTH_M,
    }
    T_map_camera = transform(np.eye(3), (3.0, 2.0, 1.0)) @ T_LINK_OPTICAL
    frames = tuple(
        Frame(sensor.name, name, images[name], LENS, T_map_camera)
        for sensor in info.sensors
        for name in MODALITIES
    )
    how = Provenance(1, 2, "a" * 64, "analytic", "0.1.0", "standard", 4)
    sample = Sample(1, 5, Pose((0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)), frames, 0.1, how)

    def arrived() -> bool:
        publication = publisher.begin(sample.outline, Time(sec=7))
        for frame in sample.frames:
            publication.add(frame)
        publication.finish(sample)
        return all(user.received[topic] for topic in (*topics, LEGEND))

    user.wait_until(arrived)
    stereo = user.received["stereo_left/disparity/disparity_image"][0]
    assert (stereo.header.stamp.sec, stereo.header.frame_id) == (7, "stereo_left_optical_frame")
    found = image_from_msg(stereo.image)
    valid = found >= stereo.min_disparity
    assert not valid[0].any()
    assert valid[1:].all()
    assert found.max() <= stereo.max_disparity
    np.testing.assert_allclose(stereo.f * stereo.t / found[valid], DEPTH_M[1:].ravel(), rtol=1e-6)
    (boxes, *_) = user.received["stereo_left/detections"]
    assert [each.id for each in boxes.detections] == ["7", "9", "70000"]
    (names, *_) = user.received[LEGEND]
    assert {each.class_id: each.class_name for each in names.class_map} == {1: "sand", 20: "rock"}
    (pose, *_) = user.received["stereo_right/transform"]
    assert (pose.header.frame_id, pose.child_frame_id) == ("map", "stereo_right_optical_frame")
    np.testing.assert_allclose(transform_from_msg(pose), T_map_camera, atol=1e-12)
