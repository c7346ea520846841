"""The ROS client of an exploring vehicle: views by service or by trajectory, depth with its pose.

Everything it knows comes from ROS: depth images, their camera and the transforms at their stamp.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Transform, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from oaisys_core.errors import DeadlineExceededError, OaisysError
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.planner import level_poses_towards
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.conversions import NS_PER_S, nanoseconds, pose_from_msg, pose_to_msg
from oaisys_ros_bridge.experiments.planner_client import PlannerClient, ReceivedView
from oaisys_ros_bridge.mapper.fusion import DepthFrame
from oaisys_ros_bridge.namespaces import TF, TF_STATIC
from oaisys_ros_bridge.qos import DEEP_QOS, LATCHED_HISTORY_QOS, SMALL_MESSAGE_QOS, TF_QOS
from oaisys_ros_bridge.subscribing.frame_assembly import FrameAssembler

FRAME_TIMEOUT_S = 20.0
"""From a view's answer until its depth image, camera and transforms are all received."""

TRAJECTORY_DEPTH = 5

POSITION_TOLERANCE_M = 1e-3
"""A rig this near to the end of its trajectory has arrived."""

MAP_FRAME = "map"


class TrajectoryClient(PlannerClient):
    """Renders from poses, and returns depth with the camera and the pose that were published."""

    def __init__(
        self, namespace: str, modalities: tuple[str, ...], ros_namespace: str = ""
    ) -> None:
        super().__init__(namespace, modalities, ros_namespace)
        self._assembler = assembler = FrameAssembler(MAP_FRAME, use_color=False)
        self._frames: dict[int, DepthFrame] = {}
        self._infos: dict[int, SampleInfo] = {}
        for message_type, topic, add, qos in (
            (TFMessage, TF_STATIC, assembler.add_static, LATCHED_HISTORY_QOS),
            (TFMessage, TF, assembler.add_transforms, TF_QOS),
            (Image, f"{namespace}/depth/image_raw", self._image_adder("depth"), DEEP_QOS),
            (CameraInfo, f"{namespace}/depth/camera_info", self._image_adder("info"), DEEP_QOS),
        ):
            self.subscribe(message_type, topic, partial(self._assemble, add), qos)
        samples = "oaisys_bridge/sample_info"
        self.subscribe(SampleInfo, samples, self._on_sample_info, SMALL_MESSAGE_QOS)
        self._trajectories = self.node.create_publisher(
            MultiDOFJointTrajectory, "command/trajectory", TRAJECTORY_DEPTH
        )

    def request_only(self, modalities: tuple[str, ...]) -> None:
        """Request no other modalities than these from now on."""
        with self.changed:
            self._modalities = modalities

    def view_by_service(self, pose: Pose, timeout_s: float) -> tuple[ReceivedView, DepthFrame]:
        """Render from a pose of the rig; return all images, and depth with camera and pose.

        Raises:
            RenderError: The bridge refused or failed; holds its message.
            DeadlineExceededError: No answer, or not all messages, in time.
        """
        with self.changed:
            self._frames.clear()
        view = self.view(pose, "", MAP_FRAME, timeout_s)
        self.wait("depth with its camera and pose", lambda: bool(self._frames), FRAME_TIMEOUT_S)
        with self.changed:
            return view, self._frames[max(self._frames)]

    def view_by_trajectory(
        self, poses: Sequence[Pose], timeout_s: float
    ) -> tuple[ReceivedView, DepthFrame]:
        """Publish a trajectory; return what `view_by_service` does, of its last pose.

        The bridge must render the last point of a trajectory only. A topic has no answer: a pose
        that the bridge refuses ends in a timeout.

        Raises:
            DeadlineExceededError: Nothing was received from there in time.
        """
        with self.changed:
            self._frames.clear()
            self._infos.clear()
        started_s = time.monotonic()
        self._trajectories.publish(trajectory_to_msg(poses, Header(frame_id=MAP_FRAME)))
        found: list[int] = []

        def has_arrived() -> bool:
            found[:] = [s for s, info in self._infos.items() if _is_at(info, poses[-1])]
            return bool(found) and self._is_complete(found[0])

        self.wait("the view at the end of a trajectory", has_arrived, timeout_s)
        with self.changed:
            stamp_ns = self._last_stamp_ns = found[0]
            images = self._pop_images(divmod(stamp_ns, NS_PER_S))
            service_s = time.monotonic() - started_s
            render_s = self._infos[stamp_ns].render_time
            return ReceivedView(images, render_s, service_s, stamp_ns), self._frames[stamp_ns]

    def wait_for_commanded_view(
        self, silence_s: float, is_over: Callable[[], bool], timeout_s: float
    ) -> tuple[ReceivedView, Pose] | None:
        """Return the next view that another node has commanded, and the rig's pose.

        Args:
            silence_s: How long to wait for one.
            is_over: Whether no more are to be expected; looked at while none comes.
            timeout_s: From its announcement until all of its images must have been received.

        Returns:
            None: no view was announced in time, or before it was over.

        Raises:
            OaisysError: Announcements or images were not received.
        """
        last_ns = self._last_stamp_ns
        self.wait("the last view's announcement", lambda: last_ns in self._infos, FRAME_TIMEOUT_S)
        try:
            self.wait("a view", lambda: self._next_stamp_ns() is not None or is_over(), silence_s)
        except DeadlineExceededError:
            return None
        with self.changed:
            stamp_ns = self._next_stamp_ns()
            if stamp_ns is None:
                return None
            info, before = self._infos[stamp_ns], self._infos[last_ns]
        missing = info.sequence - before.sequence - 1
        if missing:
            raise OaisysError(f"{missing} view(s) before sample {info.sample_id} were not received")
        began_s = time.monotonic()
        what = f"the images of sample {info.sample_id}"
        stamp = divmod(stamp_ns, NS_PER_S)
        self.wait(what, lambda: self._has_images(stamp) or self._are_lost(stamp), timeout_s)
        if not self._has_images(stamp):
            raise OaisysError(f"{what} were not received, though those of a later one were")
        with self.changed:
            self._last_stamp_ns = stamp_ns
            self._frames.clear()
            images = self._pop_images(stamp)
            self._infos = {k: v for k, v in self._infos.items() if k >= stamp_ns}
        service_s = info.render_time + time.monotonic() - began_s
        view = ReceivedView(images, info.render_time, service_s, stamp_ns)
        return view, pose_from_msg(info.rig_pose, "sample_info.rig_pose")

    def _next_stamp_ns(self) -> int | None:
        """Return the stamp of the first view after the last one that was returned, if any."""
        return min((stamp for stamp in self._infos if stamp > self._last_stamp_ns), default=None)

    def replace_commands(self, pose: Pose) -> None:
        """Have the rig go to a pose instead of where earlier commands would still take it."""
        self._trajectories.publish(trajectory_to_msg([pose], Header(frame_id=MAP_FRAME)))

    def _is_complete(self, stamp_ns: int) -> bool:
        return stamp_ns in self._frames and self._has_images(divmod(stamp_ns, NS_PER_S))

    def _on_sample_info(self, message: SampleInfo) -> None:
        self._infos[nanoseconds(message.header.stamp)] = message

    def _image_adder(self, kind: str) -> Callable[[Any], None]:
        return lambda message: self._assembler.add_image(kind, message, time.monotonic())

    def _assemble(self, add: Callable[[Any], None], message: Any) -> None:
        add(message)
        while (frame := self._assembler.pop()) is not None:
            self._frames[frame.stamp_ns] = frame


def _is_at(info: SampleInfo, pose: Pose) -> bool:
    p = info.rig_pose.position
    distance_m = np.linalg.norm(np.array((p.x, p.y, p.z)) - pose.position_m)
    return bool(distance_m < POSITION_TOLERANCE_M)


def trajectory_to_msg(poses: Sequence[Pose], header: Header) -> MultiDOFJointTrajectory:
    """Return the message of a rig's trajectory through poses."""
    message = MultiDOFJointTrajectory(header=header, joint_names=["base_link"])
    for pose in poses:
        msg = pose_to_msg(pose)
        position = Vector3(x=msg.position.x, y=msg.position.y, z=msg.position.z)
        transform = Transform(translation=position, rotation=msg.orientation)
        message.points.append(MultiDOFJointTrajectoryPoint(transforms=[transform]))
    return message


def poses_along(path_m: FloatArray, last: Pose) -> list[Pose]:
    """Return level poses along (K, 3) positions, each turned to the next one, and ``last``."""
    turned = level_poses_towards(path_m[:-1], path_m[1:]) if len(path_m) > 1 else []
    return [*turned, last]
