"""What a live view shows of a running system: the topics of bridge and mapper."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

from oaisys_core.errors import OaisysError
from oaisys_core.types import DEPTH, RGB, SEMANTIC_0
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.report.web_viewer import PosedImages
from oaisys_msgs.msg import SampleInfo, SemanticLabels
from oaisys_ros_bridge.clouds import mesh_from_marker
from oaisys_ros_bridge.live_view.source import News, ViewSource, seen_view
from oaisys_ros_bridge.mapper.fusion import DepthFrame
from oaisys_ros_bridge.publishing.stamps import nanoseconds
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, LATCHED_QOS, SENSOR_QOS, TF_QOS
from oaisys_ros_bridge.subscribing.frame_assembly import COLOR_WAIT_S, FrameAssembler
from oaisys_ros_bridge.transport import prepare_transport

KINDS = {"depth": DEPTH, "color": RGB, "semantic": SEMANTIC_0}
"""Modalities by what the assembler calls their images."""


class RosSource(ViewSource):
    """A node that listens to a camera's images and the mapper's mesh."""

    def __init__(self, cameras: Sequence[str], map_frame: str) -> None:
        """Join ROS.

        Args:
            cameras: Prefixes of the cameras' topics.
            map_frame: Frame to show everything in.
        """
        self.labels = {}
        self._news: queue.Queue[News] = queue.Queue()
        self._batch: tuple[str, int, int] | None = None
        prepare_transport()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("oaisys_view")
        self._cameras = [_Camera(name, map_frame) for name in cameras]
        for camera in self._cameras:
            self._listen_to(camera)
        self._subscribe(
            SemanticLabels, f"{cameras[0]}/semantic_0/labels", self._on_labels, LATCHED_QOS
        )
        self._subscribe(SampleInfo, "oaisys_bridge/batch", self._on_batch, LATCHED_QOS)
        self._subscribe(Marker, "oaisys_mapper/mesh", self._on_mesh, LATCHED_QOS)
        self._node.create_timer(COLOR_WAIT_S / 2, self._give_up_color)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._spinner = threading.Thread(target=self._spin, name="view executor", daemon=True)
        self._spinner.start()

    def close(self) -> None:
        """Leave ROS."""
        self._executor.shutdown(timeout_sec=2.0)
        rclpy.try_shutdown()
        self._spinner.join(timeout=2.0)

    def news(self, timeout_s: float) -> News | None:
        """Return what has come since the last call, the oldest first."""
        try:
            return self._news.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def _listen_to(self, camera: _Camera) -> None:
        assembler = camera.assembler
        take: Callable[..., Any] = partial(self._take_in, camera)
        self._subscribe(
            TFMessage, "/tf_static", partial(take, assembler.add_static), LATCHED_HISTORY_QOS
        )
        self._subscribe(TFMessage, "/tf", partial(take, assembler.add_transforms), TF_QOS)
        end = partial(take, camera.end_sample)
        self._subscribe(SampleInfo, "oaisys_bridge/sample_info", end, SENSOR_QOS)
        for kind, message_type, topic in (
            ("depth", Image, "depth/image_raw"),
            ("info", CameraInfo, "depth/camera_info"),
            ("color", Image, "color/image_raw"),
            ("semantic", Image, "semantic_0/image_raw"),
        ):
            add = partial(take, partial(camera.add_image, kind))
            self._subscribe(message_type, f"{camera.name}/{topic}", add, SENSOR_QOS)

    def _subscribe(
        self, kind: type[Any], topic: str, take: Callable[[Any], None], qos: QoSProfile
    ) -> None:
        self._node.create_subscription(kind, topic, take, qos)

    def _take_in(self, camera: _Camera, add: Callable[[Any], None], message: Any) -> None:
        """Give a message to a camera and pass on what it completed."""
        try:
            add(message)
            while (frame := camera.assembler.pop()) is not None:
                self._news.put(News(views=[camera.view_of(frame)]))
        except OaisysError as error:
            self._node.get_logger().warning(f"a message cannot be used: {error}")

    def _give_up_color(self) -> None:
        are_told = self._node.count_publishers("oaisys_bridge/sample_info") > 0
        for camera in self._cameras:
            give_up = partial(camera.assembler.give_up_color, ends_are_told=are_told)
            self._take_in(camera, give_up, time.monotonic())

    def _on_labels(self, message: SemanticLabels) -> None:
        self.labels = {label.id: label.name for label in message.labels}

    def _on_batch(self, message: SampleInfo) -> None:
        batch = (message.config_sha256, message.seed, message.batch_id)
        known, self._batch = self._batch, batch
        if known not in (None, batch):
            self._news.put(News(new_world=True))

    def _on_mesh(self, message: Marker) -> None:
        corners_m, colors_rgb = mesh_from_marker(message)
        if not len(corners_m):
            return
        self.tells_mesh = True
        triangles = np.arange(3 * len(corners_m), dtype=np.int32).reshape(-1, 3)
        mesh = ColoredMesh(corners_m.reshape(-1, 3), triangles, colors_rgb.reshape(-1, 3))
        self._news.put(News(mesh=mesh))

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return


class _Camera:
    """Puts together what the topics of one camera bring."""

    def __init__(self, name: str, map_frame: str) -> None:
        self.name = name
        self.assembler = FrameAssembler(map_frame, use_color=True, use_semantics=True)
        self._views = 0

    def add_image(self, kind: str, message: Any) -> None:
        """Take in a message that is one of `KINDS`, or ``info``, of its stamp."""
        self.assembler.add_image(kind, message, time.monotonic())

    def end_sample(self, message: SampleInfo) -> None:
        """Take note that all of a sample was published, and which images are among it."""
        modalities = {
            modality
            for sensor in message.sensors
            if sensor.sensor == self.name or len(message.sensors) == 1
            for modality in sensor.modalities
        }
        kinds = [kind for kind, modality in KINDS.items() if modality in modalities]
        self.assembler.end_sample(nanoseconds(message.header.stamp), time.monotonic(), kinds=kinds)

    def view_of(self, frame: DepthFrame) -> PosedImages:
        """Return what is shown of a frame."""
        self._views += 1
        images: dict[str, Any] = {DEPTH: frame.depth_m}
        if frame.rgb is not None:
            images[RGB] = frame.rgb
        if frame.labels is not None:
            images[SEMANTIC_0] = frame.labels
        name = f"{self._views} {self.name}"
        return seen_view(name, images, frame.intrinsics, frame.T_map_camera)
