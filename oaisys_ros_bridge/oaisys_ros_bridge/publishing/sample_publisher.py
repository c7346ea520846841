"""Publishes samples: every message of one sample with one stamp, and ``~/sample_info`` about it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.node import Node
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.sensing.faults import CaptureId, DepthFaults, measure_frame
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    RGB,
    SEMANTIC_0,
    DriveInstant,
    Frame,
    FrameName,
    LidarScan,
    Pose,
    Sample,
    SampleOutline,
    SceneObject,
    SimulatorInfo,
)
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.parameters.table import Settings
from oaisys_ros_bridge.publishing.imu_topics import ImuTopics
from oaisys_ros_bridge.publishing.lidar_topics import LidarTopics
from oaisys_ros_bridge.publishing.place_topics import PlaceTopics, map_on_earth
from oaisys_ros_bridge.publishing.publishers import NodePublishers
from oaisys_ros_bridge.publishing.rig_topics import RigTopics
from oaisys_ros_bridge.publishing.sample_info import Announcements, sample_info_msg
from oaisys_ros_bridge.publishing.sensor_topics import SensorTopics, find_left_camera
from oaisys_ros_bridge.publishing.trajectory_topics import TrajectoryTopics
from oaisys_ros_bridge.qos import LATCHED_QOS, SMALL_MESSAGE_QOS
from oaisys_ros_bridge.topic_names import sensor_namespace


class SamplePublisher:
    """Publishers for one simulator's sensors.

    Args:
        node: Owner of the publishers.
        info: The simulator, whose sensors and labels settle the topics.
        settings: Returns the values of the node's parameters; the names of frames are read now,
            everything else once for each sample.
        announcements: Gives the samples their numbers.
        now: Returns the time of messages that belong to no sample; None: that of the node's clock.

    Attributes:
        publishers: All of them.
        rig, trajectory: The topics of the rig.
        sensors: The topics of each camera, by its name.
        lidars: The topics of each lidar, by its name.
        imus: The topics of each IMU, by its name.
    """

    def __init__(
        self,
        node: Node,
        info: SimulatorInfo,
        settings: Settings,
        announcements: Announcements | None = None,
        *,
        now: Callable[[], Time] | None = None,
    ) -> None:
        self._now = now or (lambda: node.get_clock().now().to_msg())
        self._info = info
        self._settings = settings
        values = settings()
        self._map_frame = values["map_frame"]
        self._announcements = announcements or Announcements()
        self.publishers = NodePublishers(node)
        self.rig = RigTopics(
            self.publishers, self._map_frame, values["base_frame"], values["odom_frame"]
        )
        self._base_frame, self._earth_frame = values["base_frame"], values["earth_frame"]
        self._place = PlaceTopics(self.publishers, self._base_frame, values["magnetic_year"])
        self._static = self.publishers.offer(TFMessage, "/tf_static", LATCHED_QOS)
        self._sample_info = self.publishers.offer(SampleInfo, "~/sample_info", SMALL_MESSAGE_QOS)
        self.trajectory = TrajectoryTopics(node, self.publishers, self._map_frame)
        left_cameras = {each.name: find_left_camera(each, info.sensors) for each in info.sensors}
        baselines_m = {left_cameras[each.name]: each.stereo_baseline_m for each in info.sensors}
        self.sensors = {
            sensor.name: SensorTopics(
                self.publishers,
                sensor,
                sensor_namespace(sensor.name, info.sensors),
                values["frame_prefix"],
                left_cameras[sensor.name] if values["stereo.right_frame"] == "left" else "",
                baselines_m.get(sensor.name, 0.0),
            )
            for sensor in info.sensors
        }
        self.lidars = {
            lidar.name: LidarTopics(
                self.publishers,
                lidar,
                sensor_namespace(lidar.name, info.lidars, only="lidar"),
                values["frame_prefix"],
            )
            for lidar in info.lidars
        }
        self.imus = {
            imu.name: ImuTopics(
                self.publishers,
                imu,
                sensor_namespace(imu.name, info.imus, only="imu"),
                values["frame_prefix"],
            )
            for imu in info.imus
        }
        self._publish_fixed_frames()
        self._publish_labels()

    def fits(self, info: SimulatorInfo) -> bool:
        """Return whether ``info`` has the same sensors, so that the publishers can stay."""
        return _sensors(info) == _sensors(self._info)

    def update(self, info: SimulatorInfo) -> None:
        """Publish the legend again if a new batch has other labels; clear path and viewpoints."""
        before, self._info = self._info, info
        if dict(info.semantic_labels) != dict(before.semantic_labels):
            self._publish_labels()
        if info.georeference != before.georeference:
            self._publish_fixed_frames()
        self.trajectory.enter((info.config_sha256, info.seed, info.batch_id))

    def destroy(self) -> None:
        """Take the publishers off the node."""
        self.trajectory.destroy()
        self.publishers.destroy()

    def begin(
        self, outline: SampleOutline, stamp: Time, instant: DriveInstant | None = None
    ) -> Publication:
        """Begin to publish a sample: publish where the rig is.

        Args:
            outline: The sample without its frames.
            stamp: Of all its messages.
            instant: The time of a drive to which it belongs; None: it belongs to no drive.
        """
        return Publication(self, outline, stamp, self._settings(), instant)

    def publish_instant(self, instant: DriveInstant, stamp: Time) -> None:
        """Publish what a drive brings at one time besides images and scans."""
        self.rig.publish_instant(instant, stamp, tf_drifts=self._settings()["faults.tf_drifts"])
        for reading in instant.imus:
            self.imus[reading.sensor].publish(
                reading.angular_rate_rad_s, reading.specific_force_m_s2, stamp
            )

    def publish_place(self, pose: Pose, stamp: Time) -> None:
        """Publish where the rig is on Earth, if the ground says where it lies."""
        self._place.publish(pose, self._info.georeference, stamp)

    def announce(self, sample: Sample, stamp: Time, faults: DepthFaults) -> None:
        """Announce that a sample is complete."""
        header = Header(stamp=stamp, frame_id=self._map_frame)
        number, topics = self._announcements.add(sample, stamp), self.publishers.used
        message = sample_info_msg(sample, header, faults, sequence=number, topics=topics)
        self.publishers.send(self._sample_info, message)

    def _publish_fixed_frames(self) -> None:
        """Latch where each sensor sits on the rig, and where the world is on Earth."""
        stamp, base = self._now(), self._base_frame
        mounts = [m for topics in self.sensors.values() for m in topics.mount(base, stamp)]
        for others in (self.lidars, self.imus):
            mounts += [m for topics in others.values() for m in topics.mount(base, stamp)]
        self.rig.frames.set_mounts(mounts)
        place = self._info.georeference
        on_earth = map_on_earth(place, self._earth_frame, self._map_frame, stamp)
        self._static.publish(TFMessage(transforms=[*on_earth, *mounts]))

    def _publish_labels(self) -> None:
        stamp = self._now()
        for topics in self.sensors.values():
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
        values: Mapping[str, Any],
        instant: DriveInstant | None = None,
    ) -> None:
        self.stamp = stamp
        self.seconds = 0.0
        self._publisher = publisher
        self._outline = outline
        self._values = values
        self._faults = depth_faults(values)
        self._frames: dict[FrameName, Frame] = {}
        self._placed: set[str] = set()
        publisher.publishers.used.clear()
        with self._count_time():
            publisher.publish_place(outline.rig_pose, stamp)
            if instant is None:
                publisher.rig.publish(outline, stamp, values)
            else:
                publisher.publish_instant(instant, stamp)

    def add(self, frame: Frame | LidarScan) -> None:
        """Publish a scan, or a frame with the faults of its sensor and the cloud it completes."""
        with self._count_time():
            if isinstance(frame, LidarScan):
                self._publisher.lidars[frame.sensor].publish(frame, self.stamp)
                return
            capture = CaptureId(self._outline.batch_id, self._outline.sample_id, frame.sensor)
            frame = measure_frame(frame, self._faults, capture)
            topics = self._publisher.sensors[frame.sensor]
            if frame.sensor not in self._placed:
                self._placed.add(frame.sensor)
                map_frame = self._values["map_frame"]
                topics.publish_transform(frame.T_map_camera, map_frame, self.stamp)
            topics.publish_frame(frame, self.stamp, self._values)
            self._frames[FrameName(frame.sensor, frame.modality)] = frame
            if frame.modality in (DEPTH, RGB):
                self._publish_cloud(frame.sensor)
            if frame.modality in (INSTANCE, SEMANTIC_0):
                self._publish_detections(frame.sensor)

    @property
    def wants_boxes(self) -> bool:
        """Whether somebody subscribes to the boxes in space of objects in one of the images."""
        return bool(self._images_of_boxes())

    def find_shown_objects(self) -> list[int]:
        """Return the ids of the objects in these images."""
        ids = {
            each for _, frame in self._images_of_boxes() for each in np.unique(frame.data).tolist()
        }
        return sorted(ids - {0})

    def publish_boxes(self, objects: Sequence[SceneObject]) -> None:
        """Publish the boxes in space of objects, as they were at the sample."""
        with self._count_time():
            for topics, frame in self._images_of_boxes():
                topics.publish_boxes(objects, frame, self.stamp)

    def _images_of_boxes(self) -> list[tuple[SensorTopics, Frame]]:
        """Return images of ids whose objects' boxes somebody subscribes to."""
        sensors = self._publisher.sensors
        return [
            (sensors[name.sensor], frame)
            for name, frame in self._frames.items()
            if name.modality == INSTANCE and sensors[name.sensor].wants_boxes
        ]

    def finish(self, sample: Sample) -> None:
        """Publish path and viewpoints, and announce that the sample is complete."""
        with self._count_time():
            self._publisher.trajectory.add(sample, self.stamp, self._values)
            self._publisher.announce(sample, self.stamp, self._faults)

    @contextmanager
    def _count_time(self) -> Iterator[None]:
        """Count the time of a block as spent on publishing."""
        started_s = time.monotonic()
        yield
        self.seconds += time.monotonic() - started_s

    def _publish_detections(self, sensor: str) -> None:
        """Publish a sensor's boxes of objects if ids, and labels if there are any, have come."""
        ids, labels = FrameName(sensor, INSTANCE), FrameName(sensor, SEMANTIC_0)
        needed = {ids, labels}.intersection(self._outline.frames)
        if ids in self._frames and needed <= self._frames.keys():
            self._publisher.sensors[sensor].publish_detections(
                self._frames[ids], self._frames.get(labels), self.stamp
            )

    def _publish_cloud(self, sensor: str) -> None:
        """Publish a sensor's cloud if all frames that it is made of have come."""
        depth, color = FrameName(sensor, DEPTH), FrameName(sensor, RGB)
        needed = {depth, color}.intersection(self._outline.frames)
        if depth in self._frames and needed <= self._frames.keys():
            self._publisher.sensors[sensor].publish_cloud(
                self._frames[depth], self._frames.get(color), self.stamp, self._values
            )


def _sensors(info: SimulatorInfo) -> list[object]:
    cameras = [
        (s.name, s.modalities, s.T_base_camera.tolist(), s.stereo_baseline_m) for s in info.sensors
    ]
    others = [(lidar.name, lidar.T_base_lidar.tolist()) for lidar in info.lidars]
    others += [(imu.name, imu.T_base_imu.tolist()) for imu in info.imus]
    return [*cameras, *others]


def depth_faults(values: Mapping[str, Any]) -> DepthFaults:
    """Return the faults of depth images from the values of the bridge's parameters."""
    return DepthFaults(
        seed=values["faults.seed"],
        noise=values["faults.depth_noise"],
        sigma_m=values["faults.depth_sigma_m"],
        sigma_per_m=values["faults.depth_sigma_per_m"],
        min_depth_m=values["faults.min_depth_m"],
        max_depth_m=values["faults.max_depth_m"],
        missing_ratio=values["faults.missing_ratio"],
    )
