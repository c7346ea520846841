"""Assembles frames for fusion from images, cameras and transforms that arrive one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_ros_bridge.conversions import (
    color_from_msg,
    depth_from_msg,
    image_from_msg,
    intrinsics_from_msg,
    nanoseconds,
    transform_from_msg,
)
from oaisys_ros_bridge.mapper.fusion import DepthFrame
from oaisys_ros_bridge.motion import odometry_from_msg
from oaisys_ros_bridge.subscribing.synchronizer import ExactSynchronizer
from oaisys_ros_bridge.subscribing.transforms import FrameBuffer

COLOR_WAIT_S = 2.0
"""How long after the end of its sample a depth image waits for colour; then it is fused grey."""

MAX_WITHOUT_POSE = 32
"""Frames that may wait for their transform; then the oldest are dropped."""

INCOMPLETE = "depth images without camera, or of no sample"
WITHOUT_POSE = "depth images without a pose"
UNUSABLE = "images that cannot be used"
"""Why a depth image becomes no frame."""


class FrameAssembler:
    """Combines messages of the same stamp, in whatever order they come.

    Args:
        map_frame: Frame of the poses.
        use_color, use_semantics: Whether a depth image waits for its colour and label images:
            until its sample is complete if that is announced, else for `COLOR_WAIT_S`.
        on_given_up: Called with the stamp of a depth image that becomes no frame, and the reason.
    """

    def __init__(
        self,
        map_frame: str,
        *,
        use_color: bool,
        use_semantics: bool = False,
        on_given_up: Callable[[int, str], object] = lambda *_: None,
    ) -> None:
        self._map_frame = map_frame
        self._on_given_up = on_given_up
        self._transforms = FrameBuffer()
        wanted = [
            kind for kind, is_used in (("color", use_color), ("semantic", use_semantics)) if is_used
        ]
        self._images = ExactSynchronizer(
            ("depth", "info"),
            wanted,
            counted=("depth",),
            on_dropped=lambda stamp_ns: on_given_up(stamp_ns, INCOMPLETE),
        )
        self._color_info: PinholeIntrinsics | None = None
        self._without_pose_lost = 0
        self._without_pose: dict[int, dict[str, Any]] = {}
        self._ended_s: dict[int, float] = {}

    def add_static(self, message: TFMessage) -> None:
        """Add transforms that hold at all times."""
        for msg in message.transforms:
            T_parent_child = transform_from_msg(msg)
            self._transforms.set_static(msg.header.frame_id, msg.child_frame_id, T_parent_child)

    def add_transforms(self, message: TFMessage) -> None:
        """Add transforms that hold at their stamps."""
        for msg in message.transforms:
            stamp_ns = nanoseconds(msg.header.stamp)
            T_parent_child = transform_from_msg(msg)
            self._transforms.set_at(
                stamp_ns, msg.header.frame_id, msg.child_frame_id, T_parent_child
            )

    def add_odometry(self, msg: Odometry) -> None:
        """Add a pose that holds at its stamp."""
        stamp_ns = nanoseconds(msg.header.stamp)
        T_parent_child = pose_to_matrix(odometry_from_msg(msg))
        self._transforms.set_at(stamp_ns, msg.header.frame_id, msg.child_frame_id, T_parent_child)

    def add_image(self, kind: str, message: Image | CameraInfo, now_s: float) -> None:
        """Add the ``depth``, ``info``, ``color`` or ``semantic`` message of a stamp."""
        stamp_ns = nanoseconds(message.header.stamp)
        complete = self._images.add(stamp_ns, kind, message, now_s)
        if complete is not None:
            self._go_on(stamp_ns, complete)

    def add_color_info(self, message: CameraInfo) -> None:
        """Set the camera of colour images, which must be that of depth images."""
        self._color_info = intrinsics_from_msg(message)

    def end_sample(self, stamp_ns: int, now_s: float, *, kinds: Iterable[str]) -> None:
        """Note that all of a sample was published, and which kinds of images it has."""
        complete = self._images.expect(stamp_ns, kinds)
        if complete is not None:
            self._go_on(stamp_ns, complete)
        self._ended_s[stamp_ns] = now_s
        while len(self._ended_s) > MAX_WITHOUT_POSE:
            del self._ended_s[min(self._ended_s)]
        self.give_up_color(now_s, samples_are_announced=True)

    def give_up_color(self, now_s: float, *, samples_are_announced: bool = False) -> None:
        """Stop waiting for the colour of depth images that have waited long enough.

        If complete samples are announced, a sample may take any time, and images of a sample that
        was never completed are dropped once a later one is complete.
        """
        if not samples_are_announced:
            for stamp_ns, messages in self._images.release_older_than(now_s - COLOR_WAIT_S):
                self._go_on(stamp_ns, messages)
            return
        overdue = [s for s, ended_s in self._ended_s.items() if now_s - ended_s >= COLOR_WAIT_S]
        for stamp_ns in overdue:
            released = self._images.release(stamp_ns)
            if released is not None:
                self._go_on(stamp_ns, released)
        last_ns = max(overdue, default=0)
        lost = [s for s in self._images.stamps_ns if s < last_ns and s not in self._ended_s]
        self._images.drop(lost)

    def _go_on(self, stamp_ns: int, messages: dict[str, Any]) -> None:
        self._without_pose[stamp_ns] = messages
        while len(self._without_pose) > MAX_WITHOUT_POSE:
            oldest_ns = min(self._without_pose)
            del self._without_pose[oldest_ns]
            self._without_pose_lost += 1
            self._on_given_up(oldest_ns, WITHOUT_POSE)

    @property
    def dropouts(self) -> int:
        """How many depth images were dropped for lack of a camera, a pose or their sample."""
        return self._images.given_up + self._without_pose_lost

    def pop(self) -> DepthFrame | None:
        """Remove and return the earliest complete frame; None if there is none.

        Raises:
            InvalidInputError: Its messages cannot be used; they are removed, too.
        """
        for stamp_ns in sorted(self._without_pose):
            messages = self._without_pose[stamp_ns]
            frame_id = messages["depth"].header.frame_id
            T_map_camera = self._transforms.lookup(self._map_frame, frame_id, stamp_ns)
            if T_map_camera is None:
                continue
            del self._without_pose[stamp_ns]
            try:
                return self._frame(stamp_ns, messages, T_map_camera)
            except InvalidInputError:
                self._on_given_up(stamp_ns, UNUSABLE)
                raise
        return None

    def _frame(
        self, stamp_ns: int, messages: Mapping[str, Any], T_map_camera: FloatArray
    ) -> DepthFrame:
        camera = intrinsics_from_msg(messages["info"])
        rgb = None
        if "color" in messages:
            if self._color_info not in (None, camera):
                expected = f"the depth camera's {camera}: register depth to colour"
                raise InvalidInputError("color/camera_info", self._color_info, expected)
            rgb = color_from_msg(messages["color"])
        return DepthFrame(
            stamp_ns=stamp_ns,
            depth_m=depth_from_msg(messages["depth"]),
            rgb=rgb,
            intrinsics=camera,
            T_map_camera=T_map_camera,
            labels=image_from_msg(messages["semantic"]) if "semantic" in messages else None,
        )

    def clear(self) -> None:
        """Remove all images; keep the transforms."""
        self._images.clear()
        self._without_pose_lost = 0
        self._ended_s.clear()
        self._without_pose.clear()
