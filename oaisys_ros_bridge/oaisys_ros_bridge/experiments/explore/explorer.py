"""Explores: asks a planner where to look next, looks from there through ROS, and maps what it sees.

What it knows comes from ROS alone: depth images, their camera and transforms, at one stamp.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import Transform, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from oaisys_core.errors import OaisysError, RenderError
from oaisys_core.types import FloatArray, Pose
from oaisys_mapping.exploration.occupancy_map import Bounds, OccupancyMap
from oaisys_mapping.exploration.planner import (
    Planner,
    Situation,
    Vehicle,
    level_poses_towards,
)
from oaisys_mapping.voxels.rectification import rectified, rectified_camera
from oaisys_msgs.msg import SampleInfo
from oaisys_ros_bridge.conversions import pose_to_msg
from oaisys_ros_bridge.experiments.survey_client import ReceivedView, SurveyClient
from oaisys_ros_bridge.mapper.fusion import DepthFrame
from oaisys_ros_bridge.publishing.stamps import nanoseconds
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, SENSOR_QOS, TF_QOS
from oaisys_ros_bridge.subscribing.frame_assembly import FrameAssembler

FRAME_TIMEOUT_S = 20.0
"""From a view's answer until its depth image, camera and transforms are all there."""

TRAJECTORY_DEPTH = 5

SAME_PLACE_M = 1e-3
"""A rig this near to where it was to go has arrived."""

LOST_POSES = 5
"""So many poses in a row that the simulator refuses, and an exploration ends."""


class ExplorerClient(SurveyClient):
    """Looks from poses, and gives depth with its camera and pose as they were published."""

    def __init__(
        self,
        namespace: str,
        modalities: tuple[str, ...],
        ros_namespace: str = "",
        map_frame: str = "map",
    ) -> None:
        super().__init__(namespace, modalities, ros_namespace)
        self._map_frame = map_frame
        self._assembler = FrameAssembler(map_frame, use_color=False)
        self._frames: dict[int, DepthFrame] = {}
        assembler, node = self._assembler, self._node
        for topic, take, qos in (
            ("/tf_static", assembler.add_static, LATCHED_HISTORY_QOS),
            ("/tf", assembler.add_transforms, TF_QOS),
        ):
            node.create_subscription(TFMessage, topic, partial(self._take_in, take), qos)
        for kind, message_type, topic in (
            ("depth", Image, "depth/image_raw"),
            ("info", CameraInfo, "depth/camera_info"),
        ):
            add = partial(self._take_in, partial(self._add_image, kind))
            node.create_subscription(message_type, f"{namespace}/{topic}", add, SENSOR_QOS)
        self._infos: dict[int, SampleInfo] = {}
        node.create_subscription(
            SampleInfo, "oaisys_bridge/sample_info", self._on_sample_info, SENSOR_QOS
        )
        self._trajectories = node.create_publisher(
            MultiDOFJointTrajectory, "command/trajectory", TRAJECTORY_DEPTH
        )

    def ask_only_for(self, modalities: tuple[str, ...]) -> None:
        """Have the views from now on bring no more than these."""
        with self._changed:
            self._modalities = modalities

    def look(self, pose: Pose, sensor: str, timeout_s: float) -> tuple[ReceivedView, DepthFrame]:
        """Look from a pose and return all images, and depth with camera and pose.

        Raises:
            RenderError: The bridge refused or failed; holds its message.
            DeadlineExceededError: No answer, or not all messages, in time.
        """
        with self._changed:
            self._frames.clear()
        view = self.view(pose, sensor, self._map_frame, timeout_s)
        self._wait("depth with its camera and pose", lambda: bool(self._frames), FRAME_TIMEOUT_S)
        with self._changed:
            return view, self._frames[max(self._frames)]

    def fly(self, poses: Sequence[Pose], timeout_s: float) -> tuple[ReceivedView, DepthFrame]:
        """Publish a trajectory and return what is seen at its end: `look`, through a topic.

        The bridge must render the last point of a trajectory only. Nobody answers on a topic: what
        it refuses never comes.

        Raises:
            DeadlineExceededError: Nothing was seen from there in time.
        """
        with self._changed:
            self._frames.clear()
            self._infos.clear()
        started_s = time.monotonic()
        self._trajectories.publish(trajectory_to_msg(poses, Header(frame_id=self._map_frame)))
        found: list[int] = []

        def arrived() -> bool:
            found[:] = [s for s, info in self._infos.items() if _is_at(info, poses[-1])]
            return bool(found) and self._is_complete(found[0])

        self._wait("what is seen at a trajectory's end", arrived, timeout_s)
        with self._changed:
            stamp_ns, key = found[0], divmod(found[0], 1_000_000_000)
            view = ReceivedView(
                self._images.pop(key),
                self._infos[stamp_ns].render_time,
                time.monotonic() - started_s,
            )
            self._images = {k: v for k, v in self._images.items() if k > key}
            return view, self._frames[stamp_ns]

    def _is_complete(self, stamp_ns: int) -> bool:
        images = self._images.get(divmod(stamp_ns, 1_000_000_000), {})
        return stamp_ns in self._frames and len(images) >= len(self._modalities)

    def _on_sample_info(self, message: SampleInfo) -> None:
        with self._changed:
            self._infos[nanoseconds(message.header.stamp)] = message
            self._changed.notify_all()

    def _add_image(self, kind: str, message: Any) -> None:
        self._assembler.add_image(kind, message, time.monotonic())

    def _take_in(self, add: Callable[[Any], None], message: Any) -> None:
        with self._changed:
            add(message)
            while (frame := self._assembler.pop()) is not None:
                self._frames[frame.stamp_ns] = frame
            self._changed.notify_all()


def _is_at(info: SampleInfo, pose: Pose) -> bool:
    p = info.rig_pose.position
    way_m = np.array((p.x, p.y, p.z)) - pose.position_m
    return bool(np.linalg.norm(way_m) < SAME_PLACE_M)


def trajectory_to_msg(poses: Sequence[Pose], header: Header) -> MultiDOFJointTrajectory:
    """Return the message of a rig's way through poses."""
    message = MultiDOFJointTrajectory(header=header, joint_names=["base_link"])
    for pose in poses:
        msg = pose_to_msg(pose)
        place = Vector3(x=msg.position.x, y=msg.position.y, z=msg.position.z)
        transform = Transform(translation=place, rotation=msg.orientation)
        message.points.append(MultiDOFJointTrajectoryPoint(transforms=[transform]))
    return message


def poses_along(way_m: FloatArray, last: Pose) -> list[Pose]:
    """Return level poses along (K, 3) places, each turned to the next one, and ``last``."""
    turned = level_poses_towards(way_m[:-1], way_m[1:]) if len(way_m) > 1 else []
    return [*turned, last]


@dataclass(frozen=True)
class ExplorationLimits:
    """When an exploration ends.

    Attributes:
        views: Most views.
        path_m: Longest path flown.
    """

    views: int
    path_m: float = np.inf


@dataclass
class Exploration:
    """What was flown and seen.

    Attributes:
        poses: Of the vehicle, one per view.
        path_m: Length of the path flown, for each view, up to it.
        plan_s: How long each next pose took to find.
        views: What came back.
        refused: How many poses the simulator refused.
        voxels: What was observed.
    """

    voxels: OccupancyMap
    poses: list[Pose] = field(default_factory=list)
    path_m: list[float] = field(default_factory=list)
    plan_s: list[float] = field(default_factory=list)
    views: list[ReceivedView] = field(default_factory=list)
    refused: int = 0


def explore(
    look: Callable[[Pose, FloatArray], tuple[ReceivedView, DepthFrame]],
    planner: Planner,
    start: Pose,
    bounds: Bounds,
    vehicle: Vehicle,
    voxel_size_m: float,
    limits: ExplorationLimits,
    rng: np.random.Generator,
    goes_on: Callable[[Exploration], bool],
) -> Exploration:
    """Look from ``start``, and from where ``planner`` says, until one of them, or a limit, ends it.

    Args:
        look: Gives what is seen from a pose, to which (K, 3) places lead; raises `RenderError`
            where it is refused.
        planner: Asked after every view.
        start: A pose around which there is room for the vehicle.
        bounds: The box to fly in and to look at.
        vehicle: What flies; its camera's intrinsics and pose are those that come with the views.
        voxel_size_m: Of the observed map.
        limits: When to end.
        rng: The planner's.
        goes_on: Told after every view; says whether to go on.
    """
    found = Exploration(OccupancyMap(bounds, voxel_size_m))
    found.voxels.set_free(start.position_m, vehicle.radius_m + 2 * voxel_size_m)
    pose, flown_m, refused = start, 0.0, 0
    way_m = np.array([start.position_m])
    while len(found.poses) < limits.views:
        try:
            view, frame = look(pose, way_m)
        except RenderError:
            refused += 1
            found.refused += 1
            if not found.poses or refused == LOST_POSES:
                raise
        else:
            refused = 0
            _take_in(found.voxels, frame, vehicle)
            found.poses.append(pose)
            found.views.append(view)
            found.path_m.append(flown_m)
            if not goes_on(found):
                break
        started_s = time.perf_counter()
        situation = Situation(vehicle, found.voxels, found.poses, rng)
        wanted = planner.next_pose(situation)
        found.plan_s.append(time.perf_counter() - started_s)
        if wanted is None:
            break
        way_m = _way_to(situation, wanted)
        length_m = float(np.linalg.norm(np.diff(way_m, axis=0), axis=1).sum())
        if flown_m + length_m > limits.path_m:
            break
        pose, flown_m = wanted, flown_m + length_m
    return found


def _take_in(voxels: OccupancyMap, frame: DepthFrame, vehicle: Vehicle) -> None:
    depth_m, _ = rectified(frame.depth_m, None, frame.intrinsics)
    camera = rectified_camera(frame.intrinsics)
    voxels.integrate(depth_m, camera, frame.T_map_camera, vehicle.max_range_m)


def _way_to(situation: Situation, pose: Pose) -> FloatArray:
    """Return the (K, 3) places on the way there through what is known to be free.

    Raises:
        OaisysError: There is none: a planner must not ask for such a pose.
    """
    way_m = situation.path_m(np.asarray(pose.position_m))
    if way_m is None:
        place = np.round(pose.position_m, 2).tolist()
        raise OaisysError(f"the planner asked for {place}, to which no way is known to be free")
    return way_m
