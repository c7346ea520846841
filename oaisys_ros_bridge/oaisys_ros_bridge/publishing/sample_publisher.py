"""Publishes samples: every message of one sample with one stamp."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from itertools import count
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.sensing.faults import Shot, measured_frame
from oaisys_core.types import DEPTH, RGB, Frame, Sample, SampleOutline, SimulatorInfo
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.publishing.options import PublishingOptions
from oaisys_ros_bridge.publishing.publishers import Publishers
from oaisys_ros_bridge.publishing.rig_topics import RigTopics
from oaisys_ros_bridge.publishing.sample_info import sample_info_msg
from oaisys_ros_bridge.publishing.sensor_topics import SensorTopics, sensor_namespace
from oaisys_ros_bridge.publishing.traces import Traces
from oaisys_ros_bridge.qos import LATCHED_QOS, SMALL_MESSAGE_QOS


class SamplePublisher:
    """Publishers for one simulator's sensors.

    Args:
        node: Owner of the publishers.
        info: The simulator, whose sensors and labels settle the topics.
        settings: Returns the values of the node's parameters; frames' names are read now, all
            else once for each sample.
        numbers: Of the samples, in the order in which they get complete.
    """

    def __init__(
        self,
        node: Node,
        info: SimulatorInfo,
        settings: Callable[[], Mapping[str, Any]],
        numbers: Iterator[int] | None = None,
    ) -> None:
        self._node = node
        self._info = info
        self._settings = settings
        values = settings()
        self._map_frame = values["map_frame"]
        self._numbers = numbers or count(1)
        self._publishers = Publishers(node)
        self._rig = RigTopics(
            self._publishers, self._map_frame, values["base_frame"], values["odom_frame"]
        )
        self._sample_info = self._publishers.offer(SampleInfo, "~/sample_info", SMALL_MESSAGE_QOS)
        self._traces = Traces(node, self._publishers, self._map_frame)
        self._sensors = {
            sensor.name: SensorTopics(
                self._publishers,
                sensor,
                sensor_namespace(sensor.name, info.sensors),
                values["frame_prefix"],
            )
            for sensor in info.sensors
        }
        self._publish_mounts(values["base_frame"])
        self._publish_labels()

    def fits(self, info: SimulatorInfo) -> bool:
        """Return whether ``info`` has the same sensors, so that the publishers can stay."""
        return _sensors(info) == _sensors(self._info)

    def update(self, info: SimulatorInfo) -> None:
        """Publish the legend again if a new batch brought other labels; end its traces."""
        before, self._info = self._info, info
        if dict(info.semantic_labels) != dict(before.semantic_labels):
            self._publish_labels()
        self._traces.enter((info.config_sha256, info.seed, info.batch_id))

    def destroy(self) -> None:
        """Take the publishers off the node."""
        self._traces.destroy()
        self._publishers.destroy()

    def options(self) -> PublishingOptions:
        """Return how a sample that begins now is published."""
        return PublishingOptions.of(self._settings())

    def publish_pose(self, outline: SampleOutline, stamp: Time, options: PublishingOptions) -> None:
        """Publish where the rig is."""
        self._publishers.used.clear()
        self._rig.publish(outline, stamp, options)

    def repeat_transforms(self, stamp: Time) -> None:
        """Publish the rig's last transforms again under another stamp."""
        self._rig.repeat(stamp)

    def publish_frames(
        self, frames: Iterable[Frame], stamp: Time, options: PublishingOptions
    ) -> None:
        """Publish images, and their cameras."""
        for frame in frames:
            self._sensors[frame.sensor].publish_frame(frame, stamp, options)

    def publish_cloud(
        self, sensor: str, frames: Iterable[Frame], stamp: Time, options: PublishingOptions
    ) -> None:
        """Publish the cloud of a sensor's depth, in colour if there is one."""
        images = {frame.modality: frame for frame in frames if frame.sensor == sensor}
        if DEPTH in images:
            self._sensors[sensor].publish_cloud(images[DEPTH], images.get(RGB), stamp, options)

    def finish(self, sample: Sample, stamp: Time, options: PublishingOptions) -> None:
        """Say that all of a sample has been published."""
        self._traces.add(sample, stamp, options)
        header = Header(stamp=stamp, frame_id=self._map_frame)
        faults = options.depth_faults
        done = json.dumps(asdict(faults)) if faults.active else ""
        number, topics = next(self._numbers), self._publishers.used
        self._sample_info.publish(
            sample_info_msg(sample, header, done, sequence=number, topics=topics)
        )

    def _publish_mounts(self, base_frame: str) -> None:
        """Latch where each camera sits on the rig."""
        stamp = self._node.get_clock().now().to_msg()
        mounts = [m for topics in self._sensors.values() for m in topics.mount(base_frame, stamp)]
        publisher = self._publishers.offer(TFMessage, "/tf_static", LATCHED_QOS)
        publisher.publish(TFMessage(transforms=mounts))

    def _publish_labels(self) -> None:
        stamp = self._node.get_clock().now().to_msg()
        for topics in self._sensors.values():
            topics.publish_labels(self._info.semantic_labels, stamp)


def _sensors(info: SimulatorInfo) -> list[object]:
    return [
        (s.name, s.modalities, s.T_base_camera.tolist(), s.stereo_baseline_m) for s in info.sensors
    ]


def measured(frame: Frame, outline: SampleOutline, options: PublishingOptions) -> Frame:
    """Return what a frame's sensor measures instead of the truth."""
    shot = Shot(outline.batch_id, outline.sample_id, frame.sensor)
    return measured_frame(frame, options.depth_faults, shot)
