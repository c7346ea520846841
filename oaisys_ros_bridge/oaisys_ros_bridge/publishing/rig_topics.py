"""The topics of the rig: transform, true pose and odometry.

``ground_truth/odometry`` is always exact. ``odometry`` drifts as the parameters ``faults.drift_m``
and ``faults.drift_rad`` say, with its covariance. It is then a pose in the frame ``odom``, which
coincides with ``map`` at the start, and transforms lead from ``map`` to ``odom`` to ``base_link``
(REP-105). ``map`` to ``odom`` is the correction of a perfect localisation, so that the rig is where
it truly is; with ``faults.tf_drifts`` it is the identity. Without drift ``odometry`` is the true
pose in ``map``, and ``base_link`` a child of ``map``. All are poses of the vehicle; ``/tf_static``
has the mounts of its cameras.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import invert, pose_to_matrix
from oaisys_core.sensing.faults import PoseDrift, drift_covariance, odometry_covariance
from oaisys_core.types import DriveInstant, Pose, SampleOutline, Twist
from oaisys_ros_bridge.conversions import nanoseconds, transform_to_msg
from oaisys_ros_bridge.motion import odometry_to_msg
from oaisys_ros_bridge.publishing.frame_history import FrameHistory
from oaisys_ros_bridge.publishing.publishers import Publishers, has_subscribers
from oaisys_ros_bridge.qos import MOTION_QOS


class RigTopics:
    """Publishes the pose of the rig.

    Args:
        publishers: Where the messages go.
        map_frame: Frame of the world.
        base_frame: Frame of the rig.
        odom_frame: Frame of odometry that drifts.

    Attributes:
        frames: Where these frames, and those of sensors, have been.
    """

    def __init__(
        self, publishers: Publishers, map_frame: str, base_frame: str, odom_frame: str
    ) -> None:
        self._publishers = publishers
        self._map_frame = map_frame
        self._base_frame = base_frame
        self._odom_frame = odom_frame
        self.frames = FrameHistory(map_frame, base_frame, odom_frame)
        self._drift = PoseDrift()
        self._transforms: list[TransformStamped] = []
        self._tf = publishers.offer(TFMessage, "/tf", MOTION_QOS)
        self._truth = publishers.offer(Odometry, "ground_truth/odometry", MOTION_QOS)
        self._odometry = publishers.offer(Odometry, "odometry", MOTION_QOS)

    def publish(self, outline: SampleOutline, stamp: Time, values: Mapping[str, Any]) -> None:
        """Publish the pose of the rig at a sample, given the values of the bridge's parameters."""
        sigmas = (values["faults.drift_m"], values["faults.drift_rad"])
        true, sample_id = outline.rig_pose, outline.sample_id
        # Drift of the simulator (sensors.faults) and of the bridge add up.
        believed = self._drift.estimate(
            outline.odometry.pose if outline.odometry else true,
            sigmas,
            values["faults.seed"],
            outline.batch_id,
            sample_id,
        )
        drifts = any(sigmas) or outline.odometry is not None
        estimate = believed if drifts else None
        self.publish_transforms(true, estimate, stamp, tf_drifts=values["faults.tf_drifts"])
        covariance = drift_covariance(sigmas, sample_id)
        if outline.odometry is not None:
            covariance += odometry_covariance(outline.odometry)
        self.publish_odometry(true, estimate, stamp, covariance=covariance)

    def publish_instant(self, instant: DriveInstant, stamp: Time, *, tf_drifts: bool) -> None:
        """Publish the pose of the rig at one time of a drive, and odometry if that is due.

        Drift is that of the drive; the bridge's is one of samples, and is not added.
        """
        estimated = instant.odometry
        estimate = None if estimated is None else estimated.pose
        self.publish_transforms(instant.pose, estimate, stamp, tf_drifts=tf_drifts)
        if instant.has_odometry:
            twist = Twist(instant.velocity_m_s, instant.angular_rate_rad_s)
            covariance = None if estimated is None else odometry_covariance(estimated)
            self.publish_odometry(instant.pose, estimate, stamp, twist=twist, covariance=covariance)

    def publish_transforms(
        self, true: Pose, estimate: Pose | None, stamp: Time, *, tf_drifts: bool = False
    ) -> None:
        """Publish where the rig is on ``/tf``.

        Args:
            true: Its pose.
            estimate: That of its odometry; None if it does not drift.
            stamp: When it is there.
            tf_drifts: Whether the transforms lead to the estimate instead of the true pose.
        """
        in_map, in_odom = self._headers(stamp)
        T_map_odom, T_map_base = np.eye(4), pose_to_matrix(true)
        if estimate is None:
            self._transforms = [transform_to_msg(T_map_base, in_map, self._base_frame)]
        else:
            if tf_drifts:
                T_map_base = pose_to_matrix(estimate)
            else:
                T_map_odom = pose_to_matrix(true) @ invert(pose_to_matrix(estimate))
            self._transforms = [
                transform_to_msg(T_map_odom, in_map, self._odom_frame),
                transform_to_msg(pose_to_matrix(estimate), in_odom, self._base_frame),
            ]
        self.frames.add(nanoseconds(stamp), T_map_odom, T_map_base)
        self._publishers.send(self._tf, TFMessage(transforms=self._transforms))

    def publish_odometry(
        self,
        true: Pose,
        estimate: Pose | None,
        stamp: Time,
        *,
        twist: Twist | None = None,
        covariance: ArrayLike | None = None,
    ) -> None:
        """Publish ``ground_truth/odometry`` and ``odometry``.

        Args:
            true: Pose of the rig.
            estimate: That of its odometry; None if it does not drift.
            stamp: When it is there.
            twist: In ``base_link``, exact; None if it is unknown.
            covariance: (36,) covariance of the estimate; None: exact.
        """
        in_map, in_odom = self._headers(stamp)
        truth = odometry_to_msg(true, in_map, self._base_frame, twist=twist)
        self._publishers.send(self._truth, truth)
        if not has_subscribers(self._odometry):
            return
        believed, header = (true, in_map) if estimate is None else (estimate, in_odom)
        message = odometry_to_msg(believed, header, self._base_frame, covariance, twist)
        self._publishers.send(self._odometry, message)

    def _headers(self, stamp: Time) -> tuple[Header, Header]:
        """Return the headers of what is in the world's frame and in that of odometry."""
        in_odom = Header(stamp=stamp, frame_id=self._odom_frame)
        return Header(stamp=stamp, frame_id=self._map_frame), in_odom

    def repeat(self, stamp: Time) -> None:
        """Publish the last transforms again, if there are any, for late subscribers."""
        for transform in self._transforms:
            transform.header.stamp = stamp
        if self._transforms:
            self._tf.publish(TFMessage(transforms=self._transforms))
