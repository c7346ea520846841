"""The source of a live view that subscribes to the topics of bridge and mapper."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

from oaisys_core.errors import OaisysError
from oaisys_core.types import DEPTH, RGB, SEMANTIC_0
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report.web_viewer import PosedImages
from oaisys_msgs.msg import SampleInfo, SemanticLabels
from oaisys_ros_bridge.clouds import mesh_from_marker
from oaisys_ros_bridge.conversions import nanoseconds
from oaisys_ros_bridge.live_view.source import LiveSource, LiveUpdate, images_with_pose
from oaisys_ros_bridge.mapper.fusion import DepthFrame
from oaisys_ros_bridge.nodes.background_node import BackgroundNode
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, LATCHED_QOS, SENSOR_QOS, TF_QOS
from oaisys_ros_bridge.subscribing.foreign_names import class_names_of
from oaisys_ros_bridge.subscribing.frame_assembly import COLOR_WAIT_S, FrameAssembler
from oaisys_ros_bridge.subscribing.sample_watch import camera_poses

KINDS = {"depth": DEPTH, "color": RGB, "semantic": SEMANTIC_0}
"""Modalities by the assembler's name of their images."""


class RosSource(LiveSource):
    """A node that subscribes to cameras' images and the mapper's mesh."""

    def __init__(self, cameras: Sequence[str], map_frame: str) -> None:
        """Join the ROS graph.

        Args:
            cameras: Prefixes of the cameras' topics.
            map_frame: Frame in which everything is shown.
        """
        self.labels = {}
        self._updates: queue.Queue[LiveUpdate] = queue.Queue()
        self._batch: tuple[str, int, int] | None = None
        self._client = BackgroundNode("oaisys_view")
        self._cameras = [_Camera(name, map_frame) for name in cameras]
        for camera in self._cameras:
            self._subscribe_to(camera)
        self._client.subscribe(
            SemanticLabels, f"{cameras[0]}/semantic_0/labels", self._on_labels, LATCHED_QOS
        )
        self._client.subscribe(SampleInfo, "oaisys_bridge/batch", self._on_batch, LATCHED_QOS)
        self._client.subscribe(Marker, "oaisys_mapper/mesh", self._on_mesh, LATCHED_QOS)
        self._client.node.create_timer(COLOR_WAIT_S / 2, self._give_up_color)
        self._client.start()

    def close(self) -> None:
        """Leave the ROS graph."""
        self._client.close()

    def next_update(self, timeout_s: float) -> LiveUpdate | None:
        """Return the oldest update that has not been returned, or None after ``timeout_s``."""
        try:
            return self._updates.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def _subscribe_to(self, camera: _Camera) -> None:
        assembler = camera.assembler
        take: Callable[..., Any] = partial(self._assemble, camera)
        self._client.subscribe(
            TFMessage, "/tf_static", partial(take, assembler.add_static), LATCHED_HISTORY_QOS
        )
        self._client.subscribe(TFMessage, "/tf", partial(take, assembler.add_transforms), TF_QOS)
        end = partial(take, camera.end_sample)
        self._client.subscribe(SampleInfo, "oaisys_bridge/sample_info", end, SENSOR_QOS)
        for kind, message_type, topic in (
            ("depth", Image, "depth/image_raw"),
            ("info", CameraInfo, "depth/camera_info"),
            ("color", Image, "color/image_raw"),
            ("semantic", Image, "semantic_0/image_raw"),
        ):
            add = partial(take, partial(camera.add_image, kind))
            self._client.subscribe(message_type, f"{camera.name}/{topic}", add, SENSOR_QOS)

    def _assemble(self, camera: _Camera, add: Callable[[Any], None], message: Any) -> None:
        """Add a message to a camera's frames and queue those that it completes."""
        try:
            add(message)
            while (frame := camera.assembler.pop()) is not None:
                self._updates.put(LiveUpdate(views=[camera.view_of(frame)]))
        except OaisysError as error:
            self._client.node.get_logger().warning(f"a message cannot be used: {error}")

    def _give_up_color(self) -> None:
        are_announced = self._client.node.count_publishers("oaisys_bridge/sample_info") > 0
        for camera in self._cameras:
            give_up = partial(camera.assembler.give_up_color, samples_are_announced=are_announced)
            self._assemble(camera, give_up, time.monotonic())

    def _on_labels(self, message: SemanticLabels) -> None:
        self.labels = class_names_of(message)

    def _on_batch(self, message: SampleInfo) -> None:
        batch = (message.config_sha256, message.seed, message.batch_id)
        known, self._batch = self._batch, batch
        if known not in (None, batch):
            self._updates.put(LiveUpdate(new_world=True))

    def _on_mesh(self, message: Marker) -> None:
        corners_m, colors_rgb = mesh_from_marker(message)
        if not len(corners_m):
            return
        self.has_mesh = True
        triangles = np.arange(3 * len(corners_m), dtype=np.int32).reshape(-1, 3)
        mesh = ColoredMesh(corners_m.reshape(-1, 3), triangles, colors_rgb.reshape(-1, 3))
        self._updates.put(LiveUpdate(mesh=mesh))


class _Camera:
    """Assembles the messages of one camera to frames."""

    def __init__(self, name: str, map_frame: str) -> None:
        self.name = name
        self.assembler = FrameAssembler(map_frame, use_color=True, use_semantics=True)
        self._views = 0

    def add_image(self, kind: str, message: Any) -> None:
        """Add a message that is one of `KINDS`, or ``info``."""
        self.assembler.add_image(kind, message, time.monotonic())

    def end_sample(self, message: SampleInfo) -> None:
        """Note that a sample was published completely, and with which images."""
        cameras = camera_poses(message)
        modalities = {
            modality
            for sensor in cameras
            if sensor.sensor == self.name or len(cameras) == 1
            for modality in sensor.modalities
        }
        kinds = [kind for kind, modality in KINDS.items() if modality in modalities]
        self.assembler.end_sample(nanoseconds(message.header.stamp), time.monotonic(), kinds=kinds)

    def view_of(self, frame: DepthFrame) -> PosedImages:
        """Return the images of a frame as the page shows them."""
        self._views += 1
        images: dict[str, Any] = {DEPTH: frame.depth_m}
        if frame.rgb is not None:
            images[RGB] = frame.rgb
        if frame.labels is not None:
            images[SEMANTIC_0] = frame.labels
        name = f"{self._views} {self.name}"
        return images_with_pose(name, images, frame.intrinsics, frame.T_map_camera)
