"""The topics of the rig: its transform, where it truly is, and where it believes to be.

``ground_truth/odometry`` is exact, whatever faults there are. ``odometry`` drifts as the
parameters ``faults.drift_m`` and ``faults.drift_rad`` say, and tells its covariance; without drift
it is the same. The transform of ``base_link`` is the true one unless ``faults.tf_drifts``. All are
poses of the vehicle: where a camera sits on it is in ``/tf_static``.
"""

from __future__ import annotations

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from oaisys_core.geometry import pose_to_matrix
from oaisys_core.types import SampleOutline
from oaisys_ros_bridge.conversions import odometry_to_msg, transform_to_msg
from oaisys_ros_bridge.publishers import Publishers, is_heard
from oaisys_ros_bridge.publishing_options import PublishingOptions
from oaisys_ros_bridge.qos import SENSOR_QOS, TF_QOS
from oaisys_ros_bridge.sensor_faults import PoseDrift, drift_covariance


class RigTopics:
    """Publishes where the rig is.

    Args:
        publishers: Of the node.
        map_frame: Frame of the world.
        base_frame: Frame of the rig.
    """

    def __init__(self, publishers: Publishers, map_frame: str, base_frame: str) -> None:
        self._map_frame = map_frame
        self._base_frame = base_frame
        self._drift = PoseDrift()
        self._tf = publishers.offer(TFMessage, "/tf", TF_QOS)
        self._truth = publishers.offer(Odometry, "ground_truth/odometry", SENSOR_QOS)
        self._odometry = publishers.offer(Odometry, "odometry", SENSOR_QOS)

    def publish(self, outline: SampleOutline, stamp: Time, options: PublishingOptions) -> None:
        """Publish where the rig is at a sample."""
        header = Header(stamp=stamp, frame_id=self._map_frame)
        true, sample_id = outline.rig_pose, outline.sample_id
        believed = self._drift.drifted(
            true, options.drift_sigmas, options.drift_seed, outline.batch_id, sample_id
        )
        T_map_base = pose_to_matrix(believed if options.tf_drifts else true)
        self._tf.publish(
            TFMessage(transforms=[transform_to_msg(T_map_base, header, self._base_frame)])
        )
        self._truth.publish(odometry_to_msg(true, header, self._base_frame))
        if is_heard(self._odometry):
            covariance = drift_covariance(options.drift_sigmas, sample_id)
            message = odometry_to_msg(believed, header, self._base_frame, covariance)
            self._odometry.publish(message)
