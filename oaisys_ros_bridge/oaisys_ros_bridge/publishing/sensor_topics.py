"""The topics of one camera: images, compressed images, camera_info, cloud, legend; and its mount.

Labels and ids have a companion ``image_color`` in ``rgb8``, for viewers.

P of a ``camera_info`` projects from the frame that it names. For the right camera of a stereo pair
that can be the left one's (``CameraInfo.msg``). Images of distances stay in the camera's own frame:
what reads them (depth_image_proc, our mapper) makes points with K, which are in the named frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import Header
from stereo_msgs.msg import DisparityImage
from vision_msgs.msg import Detection2DArray, Detection3DArray, LabelInfo

from oaisys_core.geometry import T_LINK_OPTICAL, invert, transform
from oaisys_core.types import (
    DEPTH,
    DISPARITY,
    DISTANCES,
    INSTANCE,
    FloatArray,
    Frame,
    SceneObject,
    SensorInfo,
    semantic_level,
)
from oaisys_msgs.msg import SemanticLabel, SemanticLabels
from oaisys_ros_bridge.clouds import CloudOptions, depth_to_cloud_msg
from oaisys_ros_bridge.conversions import (
    image_to_msg,
    intrinsics_to_msg,
    transform_to_msg,
)
from oaisys_ros_bridge.publishing.compressed import (
    Compression,
    depth_to_compressed_msg,
    image_to_compressed_msg,
)
from oaisys_ros_bridge.publishing.label_colors import color_ids
from oaisys_ros_bridge.publishing.publishers import (
    IMAGE_COLOR,
    Publishers,
    TopicPublisher,
    has_subscribers,
)
from oaisys_ros_bridge.publishing.vision import (
    boxes_msg,
    detections_msg,
    disparity_msg,
    label_info_msg,
)
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS
from oaisys_ros_bridge.topic_names import (
    COMPRESSED_DEPTH,
    encoding_of,
    has_colors,
    image_topic,
    topic_variants,
)


def find_left_camera(sensor: SensorInfo, sensors: Sequence[SensorInfo]) -> str:
    """Return the name of the left camera of the stereo pair whose right one this is, or nothing."""
    if not sensor.stereo_baseline_m:
        return ""
    to_left = transform(np.eye(3), (-sensor.stereo_baseline_m, 0.0, 0.0))
    T_base_left = sensor.T_base_camera @ to_left
    there = [s.name for s in sensors if np.allclose(s.T_base_camera, T_base_left, atol=1e-9)]
    # Another camera may have been put into the same place.
    by_name = f"{sensor.name.removesuffix('_right')}_left"
    return by_name if by_name in there else next(iter(there), "")


class SensorTopics:
    """Publishes the frames of one camera; messages without subscribers are not made.

    Args:
        publishers: Where the messages go.
        sensor: The camera.
        namespace: Prefix of its topics.
        frame_prefix: Prefix of its frames' names, before the namespace.
        pair_baseline_m: Baseline of the stereo pair whose left camera it is; 0 for other cameras.
        left: Namespace of the left camera in whose frame images are, except those of distances;
            empty: all are in the camera's own frame.
    """

    def __init__(
        self,
        publishers: Publishers,
        sensor: SensorInfo,
        namespace: str,
        frame_prefix: str,
        left: str = "",
        pair_baseline_m: float = 0.0,
    ) -> None:
        self._pair_baseline_m = pair_baseline_m
        self._publishers = publishers
        self._sensor = sensor
        self._namespace = namespace
        self._link_frame = f"{frame_prefix}{namespace}_link"
        self._optical_frame = f"{frame_prefix}{namespace}_optical_frame"
        self._is_in_left = bool(left)
        self._image_frame = f"{frame_prefix}{left or namespace}_optical_frame"
        for modality in sensor.modalities:  # before the first sample, so that subscribers find them
            self._image(modality)
            self._camera_info(modality)
            self._compressing_publishers(modality)
            if has_colors(modality):
                self._colors(modality)
        if DEPTH in sensor.modalities:
            self._cloud()
        if INSTANCE in sensor.modalities:
            self._detections()
            self._boxes()
        if self._has_disparities:
            self._disparity()
        self._transform()

    @property
    def _has_disparities(self) -> bool:
        return DISPARITY in self._sensor.modalities and self._pair_baseline_m > 0

    def mount(self, base_frame: str, stamp: Time) -> list[TransformStamped]:
        """Return the transforms from the rig to the camera."""
        T_base_link = self._sensor.T_base_camera @ invert(T_LINK_OPTICAL)
        on_base = Header(stamp=stamp, frame_id=base_frame)
        on_link = Header(stamp=stamp, frame_id=self._link_frame)
        return [
            transform_to_msg(T_base_link, on_base, self._link_frame),
            transform_to_msg(T_LINK_OPTICAL, on_link, self._optical_frame),
        ]

    def publish_labels(self, names: Mapping[int, str], stamp: Time) -> None:
        """Publish the legend of the labels of each level, latched."""
        labels = [SemanticLabel(id=i, name=name) for i, name in sorted(names.items())]
        message = SemanticLabels(header=self._header(stamp), labels=labels)
        for modality in self._sensor.modalities:
            if semantic_level(modality) is not None:
                topic = f"{self._namespace}/{modality}/labels"
                self._publishers.offer(SemanticLabels, topic, LATCHED_QOS).publish(message)
                names_of_level = label_info_msg(names, self._header(stamp))
                topic = f"{self._namespace}/{modality}/label_info"
                self._publishers.offer(LabelInfo, topic, LATCHED_QOS).publish(names_of_level)

    def publish_frame(self, frame: Frame, stamp: Time, values: Mapping[str, Any]) -> None:
        """Publish an image, raw, compressed and where it is of ids coloured, and its camera_info.

        Args:
            frame: The image.
            stamp: Of its sample.
            values: Of the bridge's parameters.
        """
        is_own = frame.modality in DISTANCES or not self._is_in_left
        header = Header(stamp=stamp, frame_id=self._optical_frame if is_own else self._image_frame)
        camera_info = self._camera_info(frame.modality)
        if has_subscribers(camera_info):
            baseline_m = 0.0 if is_own else self._sensor.stereo_baseline_m
            message = intrinsics_to_msg(frame.intrinsics, header, baseline_m)
            self._publishers.send(camera_info, message)
        image = self._image(frame.modality)
        if has_subscribers(image):
            self._publishers.send(image, image_to_msg(frame.data, encoding_of(frame), header))
        if has_colors(frame.modality) and has_subscribers(colors := self._colors(frame.modality)):
            pixels = color_ids(frame.modality, frame.data)
            self._publishers.send(colors, image_to_msg(pixels, "rgb8", header))
        if frame.modality == DISPARITY and self._has_disparities:
            disparity = self._disparity()
            if has_subscribers(disparity):
                message = disparity_msg(frame, header, self._pair_baseline_m)
                self._publishers.send(disparity, message)
        wanted = [p for p in self._compressing_publishers(frame.modality) if has_subscribers(p)]
        if wanted:
            compression = Compression(**_section(values, "compressed"))
            compressed = _compress_frame(frame, header, compression)
            for publisher in wanted:
                self._publishers.send(publisher, compressed)

    def publish_transform(self, T_map_camera: FloatArray, map_frame: str, stamp: Time) -> None:
        """Publish where the camera is, for mappers that take one message an image, as voxblox."""
        publisher = self._transform()
        if has_subscribers(publisher):
            header = Header(stamp=stamp, frame_id=map_frame)
            message = transform_to_msg(T_map_camera, header, self._optical_frame)
            self._publishers.send(publisher, message)

    def publish_detections(self, instances: Frame, labels: Frame | None, stamp: Time) -> None:
        """Publish the boxes of the objects in an image of ids, with classes if there are labels."""
        publisher = self._detections()
        if has_subscribers(publisher):
            header = Header(stamp=stamp, frame_id=self._image_frame)
            of_pixels = None if labels is None else labels.data
            message = detections_msg(instances.data, of_pixels, header)
            self._publishers.send(publisher, message)

    @property
    def wants_boxes(self) -> bool:
        """Whether somebody subscribes to the boxes of objects in space."""
        return INSTANCE in self._sensor.modalities and has_subscribers(self._boxes())

    def publish_boxes(self, objects: Sequence[SceneObject], instances: Frame, stamp: Time) -> None:
        """Publish the boxes in the camera's own frame of the objects that an image of ids shows."""
        shown = set(np.unique(instances.data).tolist())
        found = [each for each in objects if each.instance_id in shown]
        message = boxes_msg(found, instances.T_map_camera, self._header(stamp))
        self._publishers.send(self._boxes(), message)

    def publish_cloud(
        self, depth: Frame, color: Frame | None, stamp: Time, values: Mapping[str, Any]
    ) -> None:
        """Publish the cloud of a depth image, black where there is no colour image."""
        publisher = self._cloud()
        if not (values["publish_points"] and has_subscribers(publisher)):
            return
        rgb = None if color is None else color.data
        header = self._header(stamp)
        options = CloudOptions(**_section(values, "cloud"))
        cloud = depth_to_cloud_msg(depth.data, rgb, depth.intrinsics, header, options)
        self._publishers.send(publisher, cloud)

    def _header(self, stamp: Time) -> Header:
        return Header(stamp=stamp, frame_id=self._optical_frame)

    def _topic(self, modality: str, name: str) -> str:
        return image_topic(self._namespace, modality, name)

    def _image(self, modality: str) -> TopicPublisher:
        return self._publishers.offer(Image, self._topic(modality, "image_raw"), SENSOR_QOS)

    def _colors(self, modality: str) -> TopicPublisher:
        return self._publishers.offer(Image, self._topic(modality, IMAGE_COLOR), SENSOR_QOS)

    def _camera_info(self, modality: str) -> TopicPublisher:
        topic = self._topic(modality, "camera_info")
        return self._publishers.offer(CameraInfo, topic, SENSOR_QOS)

    def _compressing_publishers(self, modality: str) -> list[TopicPublisher]:
        topics = [self._topic(modality, f"image_raw/{v}") for v in topic_variants(modality)]
        return [self._publishers.offer(CompressedImage, topic, SENSOR_QOS) for topic in topics]

    def _detections(self) -> TopicPublisher:
        topic = f"{self._namespace}/detections"
        return self._publishers.offer(Detection2DArray, topic, SENSOR_QOS)

    def _boxes(self) -> TopicPublisher:
        topic = f"{self._namespace}/detections_3d"
        return self._publishers.offer(Detection3DArray, topic, SENSOR_QOS)

    def _disparity(self) -> TopicPublisher:
        topic = self._topic(DISPARITY, "disparity_image")
        return self._publishers.offer(DisparityImage, topic, SENSOR_QOS)

    def _transform(self) -> TopicPublisher:
        topic = f"{self._namespace}/transform"
        return self._publishers.offer(TransformStamped, topic, SENSOR_QOS)

    def _cloud(self) -> TopicPublisher:
        topic = f"{self._namespace}/depth_registered/points"
        return self._publishers.offer(PointCloud2, topic, SENSOR_QOS)


def _compress_frame(frame: Frame, header: Header, compression: Compression) -> Any:
    if COMPRESSED_DEPTH in topic_variants(frame.modality):
        return depth_to_compressed_msg(frame.data, header, compression)
    return image_to_compressed_msg(frame.data, encoding_of(frame), header, compression)


def _section(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the parameters ``NAME.*`` without the prefix."""
    prefix = f"{name}."
    return {k.removeprefix(prefix): v for k, v in values.items() if k.startswith(prefix)}
