"""Publishes samples: every message of one sample with one stamp."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from itertools import count
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.sensing.faults import Shot, measured_frame
from oaisys_core.types import DEPTH, RGB, Frame, FrameName, Sample, SampleOutline, SimulatorInfo
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.publishing.options import PublishingOptions
from oaisys_ros_bridge.publishing.publishers import Publishers
from oaisys_ros_bridge.publishing.rig_topics import RigTopics
from oaisys_ros_bridge.publishing.sample_info import sample_info_msg
from oaisys_ros_bridge.publishing.sensor_topics import SensorTopics, sensor_namespace
from oaisys_ros_bridge.publishing.trajectory_topics import TrajectoryTopics
from oaisys_ros_bridge.qos import LATCHED_QOS, SMALL_MESSAGE_QOS


class SamplePublisher:
    """Publishers for one simulator's sensors.

    Args:
        node: Owner of the publishers.
        info: The simulator, whose sensors and labels settle the topics.
        settings: Returns the values of the node's parameters; the names of frames are read now,
            everything else once for each sample.
        numbers: Sequence numbers of the samples.
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
        self._trajectory = TrajectoryTopics(node, self._publishers, self._map_frame)
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
        """Publish the legend again if a new batch has other labels; clear path and viewpoints."""
        before, self._info = self._info, info
        if dict(info.semantic_labels) != dict(before.semantic_labels):
            self._publish_labels()
        self._trajectory.enter((info.config_sha256, info.seed, info.batch_id))

    def destroy(self) -> None:
        """Take the publishers off the node."""
        self._trajectory.destroy()
        self._publishers.destroy()

    def repeat_transforms(self, stamp: Time) -> None:
        """Publish the rig's last transforms again under another stamp."""
        self._rig.repeat(stamp)

    def begin(self, outline: SampleOutline, stamp: Time) -> Publication:
        """Begin to publish a sample: publish where the rig is."""
        self._publishers.used.clear()
        options = PublishingOptions.of(self._settings())
        publication = Publication(self, outline, stamp, options)
        with publication.timed():
            self._rig.publish(outline, stamp, options)
        return publication

    def publish_frame(self, frame: Frame, stamp: Time, options: PublishingOptions) -> None:
        """Publish an image and its camera."""
        self._sensors[frame.sensor].publish_frame(frame, stamp, options)

    def publish_cloud(
        self, depth: Frame, color: Frame | None, stamp: Time, options: PublishingOptions
    ) -> None:
        """Publish the cloud of a sensor's depth, in colour if there is one."""
        self._sensors[depth.sensor].publish_cloud(depth, color, stamp, options)

    def finish(self, sample: Sample, stamp: Time, options: PublishingOptions) -> None:
        """Publish path and viewpoints, and announce that the sample is complete."""
        self._trajectory.add(sample, stamp, options)
        header = Header(stamp=stamp, frame_id=self._map_frame)
        faults = options.depth_faults
        faults_json = json.dumps(asdict(faults)) if faults.active else ""
        number, topics = next(self._numbers), self._publishers.used
        self._sample_info.publish(
            sample_info_msg(sample, header, faults_json, sequence=number, topics=topics)
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


class Publication:
    """One sample that is being published.

    Pose and transforms go out first, then each frame as it is added, the cloud of a sensor once its
    depth and its colour (if it will have one) are there, and at the end path, viewpoints and
    ``sample_info``, if the sample gets complete. Parameters that change meanwhile take effect at
    the next sample.

    Attributes:
        stamp: Of all its messages.
        seconds: Time spent on conversion and publishing so far.
    """

    def __init__(
        self,
        publisher: SamplePublisher,
        outline: SampleOutline,
        stamp: Time,
        options: PublishingOptions,
    ) -> None:
        self.stamp = stamp
        self.seconds = 0.0
        self._publisher = publisher
        self._outline = outline
        self._options = options
        self._frames: dict[FrameName, Frame] = {}

    def add(self, frame: Frame) -> None:
        """Publish a frame, and the cloud that it completes."""
        with self.timed():
            frame = measured(frame, self._outline, self._options)
            self._publisher.publish_frame(frame, self.stamp, self._options)
            self._frames[FrameName(frame.sensor, frame.modality)] = frame
            if frame.modality in (DEPTH, RGB):
                self._publish_cloud(frame.sensor)

    def finish(self, sample: Sample) -> None:
        """Announce that all of the sample has been published."""
        with self.timed():
            self._publisher.finish(sample, self.stamp, self._options)

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Count the time of a block as spent on publishing."""
        started_s = time.monotonic()
        yield
        self.seconds += time.monotonic() - started_s

    def _publish_cloud(self, sensor: str) -> None:
        """Publish a sensor's cloud if all frames that it is made of have come."""
        depth, color = FrameName(sensor, DEPTH), FrameName(sensor, RGB)
        needed = {depth, color}.intersection(self._outline.frames)
        if depth in self._frames and needed <= self._frames.keys():
            self._publisher.publish_cloud(
                self._frames[depth], self._frames.get(color), self.stamp, self._options
            )


def _sensors(info: SimulatorInfo) -> list[object]:
    return [
        (s.name, s.modalities, s.T_base_camera.tolist(), s.stereo_baseline_m) for s in info.sensors
    ]


def measured(frame: Frame, outline: SampleOutline, options: PublishingOptions) -> Frame:
    """Return a frame with the faults of its sensor."""
    shot = Shot(outline.batch_id, outline.sample_id, frame.sensor)
    return measured_frame(frame, options.depth_faults, shot)
