"""Writes a timed drive into a bag, on the topics and in the frames of the bridge."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from oaisys_core.drive.outputs import DriveDescription, StreamCount
from oaisys_core.errors import OaisysError
from oaisys_core.sensing.faults import odometry_covariance
from oaisys_core.types import ODOMETRY, DriveInstant, Twist, semantic_level
from oaisys_ros_bridge import ros_loading  # noqa: F401  # before what loads rclpy
from oaisys_ros_bridge.bags.bag_publishers import BagPublishers
from oaisys_ros_bridge.bags.reading import BagReader
from oaisys_ros_bridge.bags.writing import BagWriter
from oaisys_ros_bridge.conversions import stamp_from_nanoseconds
from oaisys_ros_bridge.namespaces import CLOCK, TF, TF_STATIC
from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.publishing.imu_topics import ImuTopics
from oaisys_ros_bridge.publishing.lidar_topics import LidarTopics
from oaisys_ros_bridge.publishing.rig_topics import RigTopics
from oaisys_ros_bridge.publishing.sensor_topics import SensorTopics, find_left_camera
from oaisys_ros_bridge.qos import CLOCK_QOS, LATCHED_QOS
from oaisys_ros_bridge.topic_names import image_topic, sensor_namespace

FOLDER = "bag"
"""Name of the bag in a drive's folder."""


class DriveBag:
    """Records a drive; every message is stamped and written at its simulated time.

    Args:
        description: The drive.

    Raises:
        InvalidInputError: The folder of the bag is not empty.
        OaisysError: The bag cannot be written; `write` and `finish` raise it, too.
    """

    def __init__(self, description: DriveDescription) -> None:
        self._description = description
        self._folder = description.folder / FOLDER
        with _errors_about(self._folder):
            self._bag = BagWriter(self._folder)
        self._publishers = publishers = BagPublishers(self._bag)
        info, frames = description.info, _frames()
        self._base_frame = frames["base_frame"]
        self._rig = RigTopics(publishers, **frames)
        prefix = str(BRIDGE["frame_prefix"].default)

        def topics_of(kind: Any, sensors: tuple[Any, ...], only: str) -> dict[str, Any]:
            return {
                each.name: kind(
                    publishers, each, sensor_namespace(each.name, sensors, only), prefix
                )
                for each in sensors
            }

        self._cameras = {
            each.name: SensorTopics(
                publishers,
                each,
                sensor_namespace(each.name, info.sensors),
                prefix,
                find_left_camera(each, info.sensors),  # the bridge's default
            )
            for each in info.sensors
        }
        self._lidars: dict[str, LidarTopics] = topics_of(LidarTopics, info.lidars, "lidar")
        self._imus: dict[str, ImuTopics] = topics_of(ImuTopics, info.imus, "imu")
        self._clock = publishers.offer(Clock, CLOCK, CLOCK_QOS)
        self._has_begun = False

    def write(self, instant: DriveInstant) -> None:
        """Write what is due at one time: clock, transforms, then what was measured."""
        with _errors_about(self._folder):
            self._write(instant)

    def finish(self) -> Mapping[str, StreamCount]:
        """Close the bag, read it again, and return what was due and what it holds, by topic."""
        with _errors_about(self._folder):
            self._bag.close()
            written = messages_by_topic(self._folder)
        due = topic_counts(self._description)
        return {
            topic: StreamCount(due.get(topic, 0), written.get(topic, 0))
            for topic in sorted({*due, *written})
        }

    def close(self) -> None:
        """Close the bag; what was written until then can be read."""
        with _errors_about(self._folder):
            self._bag.close()

    def _write(self, instant: DriveInstant) -> None:
        self._publishers.time_ns = instant.time_ns
        stamp = stamp_from_nanoseconds(instant.time_ns)
        self._clock.publish(Clock(clock=stamp))
        if not self._has_begun:
            self._write_latched(stamp)
            self._has_begun = True
        estimate = None if instant.odometry is None else instant.odometry.pose
        self._rig.publish_transforms(instant.pose, estimate, stamp)
        if instant.has_odometry:
            estimated = instant.odometry
            covariance = None if estimated is None else odometry_covariance(estimated)
            twist = Twist(instant.velocity_m_s, instant.angular_rate_rad_s)
            self._rig.publish_odometry(
                instant.pose, estimate, stamp, twist=twist, covariance=covariance
            )
        for imu in instant.imus:
            topics = self._imus[imu.sensor]
            topics.publish(imu.angular_rate_rad_s, imu.specific_force_m_s2, stamp)
        if instant.sample is not None:
            for frame in instant.sample.frames:
                self._cameras[frame.sensor].publish_frame(frame, stamp, {})
            for scan in instant.sample.scans:
                self._lidars[scan.sensor].publish(scan, stamp)

    def _write_latched(self, stamp: Any) -> None:
        """Write the mounts of all sensors, and the legends of all labels."""
        base = self._base_frame
        mounts = [each for topics in self._cameras.values() for each in topics.mount(base, stamp)]
        mounts += [each for topics in self._lidars.values() for each in topics.mount(base, stamp)]
        mounts += [each for topics in self._imus.values() for each in topics.mount(base, stamp)]
        static = self._publishers.offer(TFMessage, TF_STATIC, LATCHED_QOS)
        static.publish(TFMessage(transforms=mounts))
        for topics in self._cameras.values():
            topics.publish_labels(self._description.info.semantic_labels, stamp)


@contextmanager
def _errors_about(folder: Path) -> Iterator[None]:
    """Turn what the operating system says into an error that names the bag."""
    try:
        yield
    except OSError as error:
        raise OaisysError(f"{folder}: {error}") from error


def _frames() -> dict[str, str]:
    """Return the names of the rig's frames that the bridge has by default."""
    names = ("map_frame", "base_frame", "odom_frame")
    return {name: str(BRIDGE[name].default) for name in names}


def topic_counts(description: DriveDescription) -> dict[str, int]:
    """Return how many messages are due on each topic of a drive's bag."""
    info, due = description.info, description.due
    counts = {CLOCK: description.instant_count, TF: description.instant_count, TF_STATIC: 1}
    counts |= dict.fromkeys(("/ground_truth/odometry", "/odometry"), due.get(ODOMETRY, 0))
    for camera in info.sensors:
        namespace = sensor_namespace(camera.name, info.sensors)
        for modality in camera.modalities:
            for name in ("image_raw", "camera_info"):
                counts[f"/{image_topic(namespace, modality, name)}"] = due[camera.name]
            if semantic_level(modality) is not None:
                for legend in ("labels", "label_info"):
                    counts[f"/{namespace}/{modality}/{legend}"] = 1
    for lidar in info.lidars:
        counts[f"/{sensor_namespace(lidar.name, info.lidars, 'lidar')}/points"] = due[lidar.name]
    for imu in info.imus:
        counts[f"/{sensor_namespace(imu.name, info.imus, 'imu')}/data_raw"] = due[imu.name]
    return {topic: count for topic, count in counts.items() if count}


def messages_by_topic(folder: Path) -> Mapping[str, int]:
    """Return how many messages a bag holds, read one by one."""
    reader = BagReader(folder)
    return Counter(message.topic for message in reader.messages(list(reader.topics)))
