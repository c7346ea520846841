"""A ROS node that requests views and records when each message of a sample arrives."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Bool, Header
from tf2_msgs.msg import TFMessage

from oaisys_core.errors import DeadlineExceededError, RenderError
from oaisys_core.types import Pose
from oaisys_msgs.msg import SampleInfo
from oaisys_msgs.srv import SetMetadata, SetPose
from oaisys_ros_bridge.bridge.status import SUBSCRIBERS
from oaisys_ros_bridge.conversions import pose_to_stamped_msg
from oaisys_ros_bridge.experiments.status import DIAGNOSTICS_DEPTH
from oaisys_ros_bridge.qos import LATCHED_QOS, SENSOR_QOS, TF_QOS

TIMEOUT_S = 300.0
COLOR, DEPTH = "/camera/color/image_raw", "/camera/depth/image_raw"
TOPICS: dict[str, type[Any]] = {
    COLOR: Image,
    "/camera/color/camera_info": CameraInfo,
    DEPTH: Image,
    "/camera/depth/camera_info": CameraInfo,
    "/camera/depth_registered/points": PointCloud2,
    "/camera/semantic_0/image_raw": Image,
    "/camera/instance/image_raw": Image,
    "/ground_truth/odometry": Odometry,
    "/oaisys_bridge/sample_info": SampleInfo,
    "/tf": TFMessage,
}
"""Everything that the bridge publishes of a sample of one camera."""
COLORED = {COLOR, "/camera/color/camera_info"}


class Listener:
    """Requests views and receives all their messages; use it in ``with``."""

    def __init__(self) -> None:
        rclpy.init()
        self._node = Node("oaisys_bench")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._arrivals: defaultdict[tuple[int, int], dict[str, float]] = defaultdict(dict)
        self._is_ready = False
        self._matched: dict[str, int] = {}
        for topic, kind in TOPICS.items():
            qos = TF_QOS if kind is TFMessage else SENSOR_QOS
            self._node.create_subscription(kind, topic, self._note(topic), qos)
        self._node.create_subscription(Bool, "oaisys_bridge/ready", self._on_ready, LATCHED_QOS)
        self._node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, DIAGNOSTICS_DEPTH
        )
        self._set_pose = self._node.create_client(SetPose, "oaisys_bridge/set_pose")
        self._set_metadata = self._node.create_client(SetMetadata, "oaisys_bridge/set_metadata")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def wait_for_bridge(self) -> None:
        """Wait until the bridge is ready and has matched all subscriptions.

        Raises:
            DeadlineExceededError: That took too long.
        """
        self._spin_until(lambda: self._is_ready, "the bridge to be ready")
        self._spin_until(
            lambda: all(self._matched.get(topic, 0) > 0 for topic in TOPICS),
            "the bridge to know its subscribers",
        )
        self._spin_until(self._set_pose.service_is_ready, "set_pose")

    def set_metadata(self, module: str, metadata_json: str) -> None:
        """Have the bridge apply metadata at the next sample."""
        self._spin_until(self._set_metadata.service_is_ready, "set_metadata")
        request = SetMetadata.Request(module=module, metadata_json=metadata_json)
        answer = self._call(self._set_metadata, request)
        if not answer.success:
            raise RenderError(f"set_metadata refused: {answer.message}")

    def view(self, pose: Pose, topics: set[str]) -> tuple[dict[str, float], float]:
        """Request a view, wait for its messages, and return their times.

        Args:
            pose: Pose of the rig.
            topics: Topics to wait for.

        Returns:
            Seconds from the call to the arrival, by topic and for the service's ``answer``; and the
            seconds of rendering that the simulator reports.
        """
        request = SetPose.Request(pose=pose_to_stamped_msg(pose, Header(frame_id="map")))
        started_s = time.perf_counter()
        answer = self._call(self._set_pose, request)
        answered_s = time.perf_counter()
        if not answer.success:
            raise RenderError(f"set_pose failed: {answer.message}")
        key = (answer.stamp.sec, answer.stamp.nanosec)
        self._spin_until(lambda: topics <= self._arrivals[key].keys(), "all messages of a sample")
        arrived = self._arrivals.pop(key)
        self._arrivals.clear()
        seconds = {topic: at_s - started_s for topic, at_s in arrived.items()}
        return {**seconds, "answer": answered_s - started_s}, float(answer.render_time)

    def _call(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        self._spin_until(future.done, client.srv_name)
        return future.result()

    def _spin_until(self, is_so: Callable[[], bool], what: str) -> None:
        end_s = time.monotonic() + TIMEOUT_S
        while not is_so():
            if time.monotonic() > end_s:
                raise DeadlineExceededError(f"waited {TIMEOUT_S:g} s for {what}")
            self._executor.spin_once(timeout_sec=0.1)

    def _note(self, topic: str) -> Callable[[Any], None]:
        def on_message(message: Any) -> None:
            at_s = time.perf_counter()
            header = message.transforms[0].header if topic == "/tf" else message.header
            self._arrivals[header.stamp.sec, header.stamp.nanosec][topic] = at_s

        return on_message

    def _on_ready(self, message: Bool) -> None:
        self._is_ready = message.data

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for value in (value for status in message.status for value in status.values):
            if value.key.startswith(SUBSCRIBERS):
                self._matched[value.key.removeprefix(SUBSCRIBERS)] = int(value.value)
