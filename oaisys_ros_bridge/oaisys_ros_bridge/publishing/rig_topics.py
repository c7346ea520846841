"""The topics of the rig: its transform, its true pose, and its odometry.

``ground_truth/odometry`` is always exact. ``odometry`` drifts as the parameters ``faults.drift_m``
and ``faults.drift_rad`` say, with its covariance. It is then a pose in the frame ``odom``, which
coincides with ``map`` at the start, and transforms lead from ``map`` to ``odom`` to ``base_link``
(REP-105). ``map`` to ``odom`` is the correction of a perfect localisation, so that the rig is where
it truly is; with ``faults.tf_drifts`` it is the identity. Without drift ``odometry`` is the true
pose in ``map``, and ``base_link`` a child of ``map``. All are poses of the vehicle; ``/tf_static``
has the mounts of its cameras.
"""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import invert, pose_to_matrix
from oaisys_core.sensing.faults import PoseDrift, drift_covariance, odometry_covariance
from oaisys_core.types import SampleOutline
from oaisys_ros_bridge.conversions import odometry_to_msg, transform_to_msg
from oaisys_ros_bridge.publishing.options import PublishingOptions
from oaisys_ros_bridge.publishing.publishers import Publishers, is_heard
from oaisys_ros_bridge.qos import SENSOR_QOS, TF_QOS


class RigTopics:
    """Publishes the pose of the rig.

    Args:
        publishers: Of the node.
        map_frame: Frame of the world.
        base_frame: Frame of the rig.
        odom_frame: Frame of odometry that drifts.
    """

    def __init__(
        self, publishers: Publishers, map_frame: str, base_frame: str, odom_frame: str
    ) -> None:
        self._publishers = publishers
        self._map_frame = map_frame
        self._base_frame = base_frame
        self._odom_frame = odom_frame
        self._drift = PoseDrift()
        self._transforms: list[TransformStamped] = []
        self._tf = publishers.offer(TFMessage, "/tf", TF_QOS)
        self._truth = publishers.offer(Odometry, "ground_truth/odometry", SENSOR_QOS)
        self._odometry = publishers.offer(Odometry, "odometry", SENSOR_QOS)

    def publish(self, outline: SampleOutline, stamp: Time, options: PublishingOptions) -> None:
        """Publish the pose of the rig at a sample."""
        header = Header(stamp=stamp, frame_id=self._map_frame)
        true, sample_id = outline.rig_pose, outline.sample_id
        # Drift of the simulator (sensors.faults) and of the bridge add up.
        believed = self._drift.drifted(
            outline.odometry.pose if outline.odometry else true,
            options.drift_sigmas,
            options.drift_seed,
            outline.batch_id,
            sample_id,
        )
        drifts = any(options.drift_sigmas) or outline.odometry is not None
        own = Header(stamp=stamp, frame_id=self._odom_frame) if drifts else header
        if drifts:
            T_map_odom = np.eye(4)
            if not options.tf_drifts:
                T_map_odom = pose_to_matrix(true) @ invert(pose_to_matrix(believed))
            self._transforms = [
                transform_to_msg(T_map_odom, header, self._odom_frame),
                transform_to_msg(pose_to_matrix(believed), own, self._base_frame),
            ]
        else:
            self._transforms = [transform_to_msg(pose_to_matrix(true), header, self._base_frame)]
        self._publishers.send(self._tf, TFMessage(transforms=self._transforms))
        self._publishers.send(self._truth, odometry_to_msg(true, header, self._base_frame))
        if is_heard(self._odometry):
            covariance = drift_covariance(options.drift_sigmas, sample_id)
            if outline.odometry is not None:
                covariance += odometry_covariance(outline.odometry)
            message = odometry_to_msg(believed, own, self._base_frame, covariance)
            self._publishers.send(self._odometry, message)

    def repeat(self, stamp: Time) -> None:
        """Publish the last transforms again, if there are any, for late subscribers."""
        for transform in self._transforms:
            transform.header.stamp = stamp
        if self._transforms:
            self._tf.publish(TFMessage(transforms=self._transforms))
