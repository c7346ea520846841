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
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from numpy.typing import ArrayLike
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import invert, pose_to_matrix
from oaisys_core.sensing.faults import PoseDrift, drift_covariance, odometry_covariance
from oaisys_core.types import DriveInstant, FloatArray, Pose, SampleOutline, Twist
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
        self._newest: _Belief | None = None
        self._subscribers: dict[str, int] = {}
        self._tf = publishers.offer(TFMessage, "/tf", MOTION_QOS)
        self._truth = publishers.offer(Odometry, "ground_truth/odometry", MOTION_QOS)
        self._odometry = publishers.offer(Odometry, "odometry", MOTION_QOS)

    def publish_start(self, pose: Pose, stamp: Time, *, drifts: bool) -> None:
        """Publish where the rig is before the first sample of a world.

        Args:
            pose: Its pose.
            stamp: Of the messages.
            drifts: Whether odometry will drift; it has no error yet.
        """
        estimate = pose if drifts else None
        self.publish_transforms(pose, estimate, stamp)
        self.publish_odometry(pose, estimate, stamp)

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
        before = self._newest
        covariance = None if before is None or estimate is None else before.covariance
        belief = self._newest = _Belief(true, estimate, covariance, tf_drifts)
        T_map_odom, T_odom_base = belief.transforms()
        T_map_base = T_odom_base if tf_drifts else pose_to_matrix(true)
        self.frames.add(nanoseconds(stamp), T_map_odom, T_map_base)
        self._publishers.send(self._tf, self._transforms_msg(belief, stamp))

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
        tf_drifts = self._newest is not None and self._newest.tf_drifts
        belief = self._newest = _Belief(true, estimate, covariance, tf_drifts)
        self._publishers.send(self._truth, self._truth_msg(belief, stamp, twist))
        if has_subscribers(self._odometry):
            self._publishers.send(self._odometry, self._odometry_msg(belief, stamp, twist))

    def _transforms_msg(self, belief: _Belief, stamp: Time) -> TFMessage:
        in_map, in_odom = self._headers(stamp)
        T_map_odom, T_odom_base = belief.transforms()
        if belief.estimate is None:
            return TFMessage(transforms=[transform_to_msg(T_odom_base, in_map, self._base_frame)])
        return TFMessage(
            transforms=[
                transform_to_msg(T_map_odom, in_map, self._odom_frame),
                transform_to_msg(T_odom_base, in_odom, self._base_frame),
            ]
        )

    def _truth_msg(self, belief: _Belief, stamp: Time, twist: Twist | None = None) -> Odometry:
        in_map, _ = self._headers(stamp)
        return odometry_to_msg(belief.true, in_map, self._base_frame, twist=twist)

    def _odometry_msg(self, belief: _Belief, stamp: Time, twist: Twist | None = None) -> Odometry:
        in_map, in_odom = self._headers(stamp)
        believed, header = belief.estimate, in_odom
        if believed is None:
            believed, header = belief.true, in_map
        return odometry_to_msg(believed, header, self._base_frame, belief.covariance, twist)

    def _headers(self, stamp: Time) -> tuple[Header, Header]:
        """Return the headers of what is in the world's frame and in that of odometry."""
        in_odom = Header(stamp=stamp, frame_id=self._odom_frame)
        return Header(stamp=stamp, frame_id=self._map_frame), in_odom

    def has_new_subscribers(self) -> bool:
        """Return whether a topic has more subscribers than when this was last called."""
        publishers = (self._tf, self._truth, self._odometry)
        counts = {str(p.topic_name): p.get_subscription_count() for p in publishers}
        before, self._subscribers = self._subscribers, counts
        return any(count > before.get(topic, 0) for topic, count in counts.items())

    def repeat(self, stamp: Time, *, with_odometry: bool) -> None:
        """Publish where the rig is again, if that is known, for late subscribers."""
        belief = self._newest
        if belief is None:
            return
        self._tf.publish(self._transforms_msg(belief, stamp))
        if with_odometry and has_subscribers(self._truth):
            self._truth.publish(self._truth_msg(belief, stamp))
        if with_odometry and has_subscribers(self._odometry):
            self._odometry.publish(self._odometry_msg(belief, stamp))


@dataclass(frozen=True)
class _Belief:
    """Where the rig is, and what its odometry believes.

    Attributes:
        true: Its pose.
        estimate: That of its odometry; None if it does not drift.
        covariance: (36,) of the estimate; None: exact.
        tf_drifts: Whether transforms lead to the estimate instead of the true pose.
    """

    true: Pose
    estimate: Pose | None
    covariance: ArrayLike | None
    tf_drifts: bool

    def transforms(self) -> tuple[FloatArray, FloatArray]:
        """Return ``T_map_odom`` and ``T_odom_base``, (4, 4); without an estimate odom is map."""
        if self.estimate is None:
            return np.eye(4), pose_to_matrix(self.true)
        T_odom_base = pose_to_matrix(self.estimate)
        if self.tf_drifts:
            return np.eye(4), T_odom_base
        return pose_to_matrix(self.true) @ invert(T_odom_base), T_odom_base
