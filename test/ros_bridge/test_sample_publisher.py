"""What is published of a sample: each modality in its encoding, each camera's info."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from ros_peer import User
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from oaisys_core.geometry import T_LINK_OPTICAL, pixel_rays, transform
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
from oaisys_ros_bridge.conversions import image_from_msg
from oaisys_ros_bridge.parameters import BRIDGE
from oaisys_ros_bridge.publication import Publication
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS
from oaisys_ros_bridge.sample_publisher import SamplePublisher

pytestmark = pytest.mark.ros

BENT = PinholeIntrinsics(8, 6, 7.5, 7.25, 3.5, 2.25, (-0.1, 0.02, 1e-3, -2e-3, 0.0))
ENCODINGS = {
    "rgb": "rgb8",
    "depth": "32FC1",
    "range": "32FC1",
    "normal": "32FC3",
    "flow": "32FC2",
    "albedo": "rgb8",
    "instance": "32SC1",
    "semantic_0": "16UC1",
    "semantic_7": "16UC1",
}
TOPICS = {"rgb": "color", "depth": "depth"}
RIG = Pose((1.0, 2.0, 9.0), (0.0, 0.0, 0.0, 1.0))
HOW = Provenance(1, 2, "a" * 64, "analytic", "0.1.0", "standard", 4)
DEFAULTS = {row.name: row.default for row in BRIDGE}


def publish(publisher: SamplePublisher, sample: Sample, stamp: Time) -> None:
    publication = Publication(publisher, sample.outline, stamp)
    publication.add(sample.frames)
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


@pytest.fixture
def user(ros_domain_id: int) -> Iterator[User]:
    user = User()
    yield user
    user.close()


def test_every_modality_of_every_camera_is_published(user: User) -> None:
    info = pair()
    publisher = SamplePublisher(user.node, info, lambda: DEFAULTS)
    topics: dict[str, type[Any]] = {}
    for name in ("left", "right"):
        for modality in ENCODINGS:
            topics[f"{name}/{TOPICS.get(modality, modality)}/image_raw"] = Image
        topics[f"{name}/depth/camera_info"] = CameraInfo
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
            assert msg.header.frame_id == f"{name}_optical_frame"
            np.testing.assert_array_equal(image_from_msg(msg), image_of(modality))
        (camera, *_) = user.received[f"{name}/depth/camera_info"]
        assert list(camera.d) == list(BENT.distortion)
        assert camera.p[3] == (0 if name == "left" else -7.5 * 0.2)
        (cloud, *_) = user.received[f"{name}/depth_registered/points"]
        expected_m = pixel_rays(BENT) * image_of("depth")[..., None]
        np.testing.assert_allclose(cloud_from_msg(cloud)[0], expected_m, rtol=1e-6)
    assert user.received["left/semantic_7/labels"][0].labels[0].name == "sand"


def test_a_sample_at_which_nobody_rendered_is_told_of(user: User) -> None:
    info = pair()
    publisher = SamplePublisher(user.node, info, lambda: DEFAULTS)
    topic = f"{user.node.get_name()}/sample_info"
    user.listen(SampleInfo, topic, SENSOR_QOS)
    empty = Sample(1, 6, RIG, (), 0.0, HOW)

    def arrived() -> bool:
        publish(publisher, empty, Time(sec=8))
        return bool(user.received[topic])

    user.wait_until(arrived)
    (msg, *_) = user.received[topic]
    assert (msg.sample_id, list(msg.sensors)) == (6, [])
