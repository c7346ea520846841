"""Publishes samples: every message of one sample with one stamp."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import T_LINK_OPTICAL, invert, pose_to_matrix
from oaisys_core.types import (
    ALBEDO,
    DEPTH,
    FLOW,
    INSTANCE,
    NORMAL,
    RANGE,
    RGB,
    Frame,
    Pose,
    Sample,
    SensorInfo,
    SimulatorInfo,
)
from oaisys_msgs.msg import SampleInfo, SemanticLabel, SemanticLabels
from oaisys_ros_bridge.clouds import depth_to_cloud_msg
from oaisys_ros_bridge.conversions import (
    image_to_msg,
    intrinsics_to_msg,
    odometry_to_msg,
    transform_to_msg,
)
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS, TF_QOS
from oaisys_ros_bridge.sample_info import sample_info_msg

TOPIC_BY_MODALITY = {RGB: "color", DEPTH: "depth"}
"""Where a modality's topic is not called as the modality is."""


def sensor_namespace(sensor: str, sensors: Sequence[SensorInfo]) -> str:
    """Return the prefix of a sensor's topics and frames: ``camera`` for a rig's only one."""
    return sensor if len(sensors) > 1 else "camera"


def encoding_of(modality: str) -> str:
    """Return the image encoding that a modality is published in."""
    if modality.startswith("semantic_"):
        return "16UC1"
    return {
        RGB: "rgb8",
        DEPTH: "32FC1",
        RANGE: "32FC1",
        INSTANCE: "32SC1",
        NORMAL: "32FC3",
        FLOW: "32FC2",
        ALBEDO: "rgb8",
    }[modality]


class SamplePublisher:
    """Publishers for one simulator's sensors.

    Args:
        node: Owner of the publishers.
        info: The simulator, whose sensors and labels settle the topics.
        map_frame: Frame of poses and of the world.
        base_frame: Frame of the rig.
        publish_points: Whether to offer clouds.
    """

    def __init__(
        self,
        node: Node,
        info: SimulatorInfo,
        *,
        map_frame: str,
        base_frame: str,
        publish_points: bool,
    ) -> None:
        self._node = node
        self._info = info
        self._map_frame = map_frame
        self._base_frame = base_frame
        self._publish_points = publish_points
        self._namespaces = {s.name: sensor_namespace(s.name, info.sensors) for s in info.sensors}
        self._baselines_m = {s.name: s.stereo_baseline_m for s in info.sensors}
        self._publishers: dict[str, Publisher] = {}
        self._odometry = self._publisher(Odometry, "ground_truth/odometry", SENSOR_QOS)
        self._tf = self._publisher(TFMessage, "/tf", TF_QOS)
        self._sample_info = self._publisher(SampleInfo, "~/sample_info", SENSOR_QOS)
        for sensor in info.sensors:
            self._create_sensor(sensor)
        self._publish_mounts(info.sensors)
        self._publish_labels(info)

    def fits(self, info: SimulatorInfo) -> bool:
        """Return whether ``info`` has the same sensors, so that the publishers can stay."""
        return _sensors(info) == _sensors(self._info)

    def update(self, info: SimulatorInfo) -> None:
        """Publish the legend again if a new batch brought other labels."""
        if dict(info.semantic_labels) != dict(self._info.semantic_labels):
            self._publish_labels(info)
        self._info = info

    def destroy(self) -> None:
        """Take the publishers off the node."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)
        self._publishers.clear()

    def publish(self, sample: Sample, stamp: Time) -> None:
        """Publish all of ``sample`` with ``stamp``: transforms first, sample_info last."""
        self.publish_pose(sample.rig_pose, stamp)
        self.publish_frames(sample.frames, stamp)
        for sensor in {frame.sensor: None for frame in sample.frames}:
            self.publish_cloud(sensor, sample.frames, stamp)
        self.publish_info(sample, stamp)

    def publish_pose(self, rig_pose: Pose, stamp: Time) -> None:
        """Publish where the rig is."""
        header = Header(stamp=stamp, frame_id=self._map_frame)
        T_map_base = pose_to_matrix(rig_pose)
        self._tf.publish(
            TFMessage(transforms=[transform_to_msg(T_map_base, header, self._base_frame)])
        )
        self._odometry.publish(odometry_to_msg(rig_pose, header, self._base_frame))

    def publish_frames(self, frames: Iterable[Frame], stamp: Time) -> None:
        """Publish images, and their cameras."""
        for frame in frames:
            self._publish_frame(frame, stamp)

    def publish_cloud(self, sensor: str, frames: Iterable[Frame], stamp: Time) -> None:
        """Publish the cloud of a sensor's depth, in colour if there is one, where it is offered."""
        images = {frame.modality: frame for frame in frames if frame.sensor == sensor}
        if not self._publish_points or DEPTH not in images:
            return
        topic = f"{self._namespaces[sensor]}/depth_registered/points"
        publisher = self._publisher(PointCloud2, topic, SENSOR_QOS)
        if publisher.get_subscription_count() == 0:
            return  # the largest message; nobody would ever see this one
        header = Header(stamp=stamp, frame_id=self._optical_frame(sensor))
        depth = images[DEPTH]
        rgb = images[RGB].data if RGB in images else None
        publisher.publish(depth_to_cloud_msg(depth.data, rgb, depth.intrinsics, header))

    def publish_info(self, sample: Sample, stamp: Time) -> None:
        """Say that all of a sample has been published."""
        header = Header(stamp=stamp, frame_id=self._map_frame)
        self._sample_info.publish(sample_info_msg(sample, header))

    def _publisher(self, kind: type[Any], topic: str, qos: Any) -> Publisher:
        if topic not in self._publishers:
            self._publishers[topic] = self._node.create_publisher(kind, topic, qos)
        return self._publishers[topic]

    def _create_sensor(self, sensor: SensorInfo) -> None:
        """Announce a sensor's topics before its first sample, so that subscribers find them."""
        namespace = self._namespaces[sensor.name]
        for modality in sensor.modalities:
            topic = TOPIC_BY_MODALITY.get(modality, modality)
            self._publisher(Image, f"{namespace}/{topic}/image_raw", SENSOR_QOS)
            if modality in TOPIC_BY_MODALITY:
                self._publisher(CameraInfo, f"{namespace}/{topic}/camera_info", SENSOR_QOS)
        if self._publish_points:
            self._publisher(PointCloud2, f"{namespace}/depth_registered/points", SENSOR_QOS)

    def _publish_mounts(self, sensors: Sequence[SensorInfo]) -> None:
        """Latch where each camera sits on the rig."""
        stamp = self._node.get_clock().now().to_msg()
        transforms = []
        for sensor in sensors:
            namespace = self._namespaces[sensor.name]
            link = f"{namespace}_link"
            T_base_link = sensor.T_base_camera @ invert(T_LINK_OPTICAL)
            on_base = Header(stamp=stamp, frame_id=self._base_frame)
            transforms.append(transform_to_msg(T_base_link, on_base, link))
            on_link = Header(stamp=stamp, frame_id=link)
            optical = self._optical_frame(sensor.name)
            transforms.append(transform_to_msg(T_LINK_OPTICAL, on_link, optical))
        publisher = self._publisher(TFMessage, "/tf_static", LATCHED_QOS)
        publisher.publish(TFMessage(transforms=transforms))

    def _publish_labels(self, info: SimulatorInfo) -> None:
        labels = [
            SemanticLabel(id=i, name=name) for i, name in sorted(info.semantic_labels.items())
        ]
        stamp = self._node.get_clock().now().to_msg()
        for sensor in info.sensors:
            header = Header(stamp=stamp, frame_id=self._optical_frame(sensor.name))
            for modality in sensor.modalities:
                if modality.startswith("semantic_"):
                    topic = f"{self._namespaces[sensor.name]}/{modality}/labels"
                    publisher = self._publisher(SemanticLabels, topic, LATCHED_QOS)
                    publisher.publish(SemanticLabels(header=header, labels=labels))

    def _publish_frame(self, frame: Frame, stamp: Time) -> None:
        header = Header(stamp=stamp, frame_id=self._optical_frame(frame.sensor))
        prefix = f"{self._namespaces[frame.sensor]}/" + TOPIC_BY_MODALITY.get(
            frame.modality, frame.modality
        )
        if frame.modality in TOPIC_BY_MODALITY:
            camera_info = self._publisher(CameraInfo, f"{prefix}/camera_info", SENSOR_QOS)
            baseline_m = self._baselines_m[frame.sensor]
            camera_info.publish(intrinsics_to_msg(frame.intrinsics, header, baseline_m))
        image = self._publisher(Image, f"{prefix}/image_raw", SENSOR_QOS)
        image.publish(image_to_msg(frame.data, encoding_of(frame.modality), header))

    def _optical_frame(self, sensor: str) -> str:
        return f"{self._namespaces[sensor]}_optical_frame"


def _sensors(info: SimulatorInfo) -> list[object]:
    return [
        (s.name, s.modalities, s.T_base_camera.tolist(), s.stereo_baseline_m) for s in info.sensors
    ]
