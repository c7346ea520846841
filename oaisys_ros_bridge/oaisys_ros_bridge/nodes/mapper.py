"""Node ``oaisys_mapper``: rebuilds the surface from depth images, cameras and transforms."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

from oaisys_core.errors import DeadlineExceededError, NotReadyError, OaisysError
from oaisys_core.types import DEPTH, RGB
from oaisys_grpc.memory import keep_freed_memory
from oaisys_mapping.evaluation.evaluate import Extras, evaluate_reconstruction
from oaisys_mapping.evaluation.truth_io import read_truth
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import write_ply
from oaisys_mapping.tsdf import TsdfVolume
from oaisys_mapping.voxels.semantic_fusion import class_colors
from oaisys_msgs.msg import MapStatus, SampleInfo, SemanticLabels
from oaisys_msgs.srv import Evaluate, SaveMesh
from oaisys_ros_bridge.clouds import cloud_to_msg, mesh_to_marker
from oaisys_ros_bridge.mapper.fusion import DepthFrame, Fusion
from oaisys_ros_bridge.mapper.surface_messages import at_most
from oaisys_ros_bridge.nodes.node_process import OWN_CLOCK, run_node
from oaisys_ros_bridge.parameters.mapper import MAPPER, tsdf_config
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.publishing.stamps import nanoseconds
from oaisys_ros_bridge.qos import DEEP_QOS, LATCHED_HISTORY_QOS, LATCHED_QOS, SMALL_MESSAGE_QOS
from oaisys_ros_bridge.subscribing.frame_assembly import COLOR_WAIT_S, FrameAssembler
from oaisys_ros_bridge.subscribing.sample_ledger import LedgerState, shortfall
from oaisys_ros_bridge.subscribing.sample_watch import (
    SampleWatch,
    counting_losses,
    losses_msg,
    name_of,
)

BATCH_TOPIC = "oaisys_bridge/batch"
SAMPLE_INFO_TOPIC = "oaisys_bridge/sample_info"
EARLY_FRAMES = 4
"""Frames of a new world that may come before the word that it stands."""

IN_MAP = "map"
"""What is made of a sample's messages: its view in the map."""

VOLUME_SUFFIX = ".npz"
"""Of the files that ``~/save_mesh`` writes the whole volume to, instead of its mesh."""

EVALUATION_SEED = 0
"""Draws the points that are measured: the same map gets the same figures."""


class MapperNode(ParameterNode, Node):
    """Fuses every depth image whose camera and pose carry the same stamp.

    Its parameters are the table `MAPPER`. All inputs are topics of their own, relative, and so can
    be remapped one by one, for instance from nvblox's ``camera_0/depth/image``: below the camera's
    prefix ``depth/image_raw`` (``32FC1`` metres or ``16UC1`` millimetres), ``depth/camera_info``,
    ``color/image_raw`` and ``color/camera_info`` of the same camera, ``semantic_0/image_raw`` and
    ``semantic_0/labels``; poses from ``/tf`` or ``ground_truth/odometry``.

    Every sample that is announced on ``oaisys_bridge/sample_info`` with a depth image of the camera
    is expected in the map. What has become of it is told on ``oaisys_bridge/receipts``, for which
    the bridge waits, and what is missing in ``~/metrics`` and by the services.

    Depth images of a sample that never gets complete are dropped where the bridge tells on
    ``oaisys_bridge/sample_info`` which samples do; without colour and classes they are fused at
    once.
    """

    def __init__(self) -> None:
        super().__init__("oaisys_mapper")
        values = self.declare_table(MAPPER)
        config = tsdf_config(values)
        self._config = config
        self._map_frame = values["map_frame"]
        self._metrics_json = ""
        self._published_frames = 0
        self._class_names: dict[int, str] = {}
        self._lost_by_middleware: Counter[str] = Counter()
        self._samples = SampleWatch(
            self,
            self.resolve_topic_name(SAMPLE_INFO_TOPIC),
            self._lost_by_middleware,
            on_settled=self._on_settled,
        )
        self._before_map = LedgerState()
        self._warned = 0
        self._told: MapStatus | None = None
        self._assembler = FrameAssembler(
            self._map_frame,
            use_color=values["use_color"],
            use_semantics=values["use_semantics"],
            on_given_up=self._samples.ledger.give_up,
        )
        self._input_lock = threading.RLock()
        self._status_lock = threading.Lock()
        self._batch: tuple[str, int, int] | None = None
        self._batch_begin_ns = 0
        self._newest: deque[DepthFrame] = deque(maxlen=EARLY_FRAMES)
        self._mesh_publisher = self.create_publisher(Marker, "~/mesh", LATCHED_QOS)
        self._points_publisher = self.create_publisher(PointCloud2, "~/surface_points", LATCHED_QOS)
        self._status_publisher = self.create_publisher(MapStatus, "~/metrics", LATCHED_QOS)
        self._fusion = Fusion(
            config,
            on_change=lambda _: self._publish_status(),
            on_error=self.get_logger().warning,
            on_done=self._on_fused,
        )
        self._subscribe(values)
        self._offer_services(values["mesh_period"])
        self._publish_status()

    def close(self) -> None:
        """End the fusion's thread."""
        self._samples.end()
        self._fusion.close()

    def _subscribe(self, values: Mapping[str, Any]) -> None:
        camera = values["camera"]
        assembler = self._assembler
        self._feed(TFMessage, "/tf_static", assembler.add_static, LATCHED_HISTORY_QOS)
        if values["use_odometry"]:
            pose_topic = "ground_truth/odometry"
            self._feed(Odometry, pose_topic, assembler.add_odometry, SMALL_MESSAGE_QOS)
        else:
            pose_topic = "/tf"
            self._feed(TFMessage, pose_topic, assembler.add_transforms, SMALL_MESSAGE_QOS)
        inputs: list[tuple[str, type[Any], str]] = [
            ("depth", Image, "depth/image_raw"),
            ("info", CameraInfo, "depth/camera_info"),
        ]
        level = f"semantic_{values['semantic_level']}"
        if values["use_color"]:
            inputs.append(("color", Image, "color/image_raw"))
            add_info = assembler.add_color_info
            self._feed(CameraInfo, f"{camera}/color/camera_info", add_info, DEEP_QOS)
        if values["use_semantics"]:
            inputs.append(("semantic", Image, f"{level}/image_raw"))
            legend = f"{camera}/{level}/labels"
            self.create_subscription(SemanticLabels, legend, self._on_labels, LATCHED_QOS)
        self._end_kinds = {RGB: "color", level: "semantic"}
        self._announcements = self._feed(
            SampleInfo, SAMPLE_INFO_TOPIC, partial(self._end_sample, camera), SMALL_MESSAGE_QOS
        )
        if values["use_color"] or values["use_semantics"]:
            self.create_timer(COLOR_WAIT_S / 2, self._give_up_color, clock=OWN_CLOCK)
        if values["clear_on_batch"]:
            self.create_subscription(SampleInfo, BATCH_TOPIC, self._on_batch, LATCHED_QOS)
        for kind, message_type, topic in inputs:
            add = partial(self._add_image, kind)
            self._feed(message_type, f"{camera}/{topic}", add, DEEP_QOS)
        self._topics = {kind: self.resolve_topic_name(f"{camera}/{t}") for kind, _, t in inputs}
        self._topics["pose"] = self.resolve_topic_name(pose_topic)

    def _feed(
        self, kind: type[Any], topic: str, add: Callable[[Any], None], qos: QoSProfile
    ) -> Subscription:
        """Subscribe a topic whose messages ``add`` gives to the assembler."""
        name = self.resolve_topic_name(topic)

        def take(message: Any) -> None:
            self._take_in(add, message)
            for stamp_ns in _stamps_of(message):
                self._samples.ledger.arrive(name, stamp_ns)

        return self.create_subscription(
            kind,
            topic,
            take,
            qos,
            # Of one group the executor takes whichever topic comes first, and starves the others.
            callback_group=MutuallyExclusiveCallbackGroup(),
            event_callbacks=counting_losses(self._lost_by_middleware, name),
        )

    def _add_image(self, kind: str, message: Any) -> None:
        self._assembler.add_image(kind, message, time.monotonic())

    def _end_sample(self, camera: str, message: SampleInfo) -> None:
        """Let a depth image go on whose sample is complete, and drop those of failed samples."""
        modalities = {
            modality
            for sensor in message.sensors
            if sensor.sensor == camera or len(message.sensors) == 1
            for modality in sensor.modalities
        }
        stamp_ns = nanoseconds(message.header.stamp)
        told = [kind for modality, kind in self._end_kinds.items() if modality in modalities]
        self._assembler.end_sample(stamp_ns, time.monotonic(), kinds=told)
        self._expect(message, told if DEPTH in modalities else None)

    def _expect(self, message: SampleInfo, kinds: Sequence[str] | None) -> None:
        """Expect a sample in the map, with these kinds beside depth; None: it has no depth."""
        name, ledger = name_of(message), self._samples.ledger
        if kinds is None or name.stamp_ns < self._batch_begin_ns:
            ledger.announce(name, message.sequence, ())
            return
        needed = [self._topics[kind] for kind in ("depth", "info", "pose")]
        topics = [*needed, *(self._topics[kind] for kind in kinds if kind in self._topics)]
        ledger.announce(name, message.sequence, topics, needed=needed, result=IN_MAP)

    def _on_fused(self, stamp_ns: int, fault: str) -> None:
        """Take note of what has become of a frame."""
        if fault:
            self._samples.ledger.give_up(stamp_ns, fault)
        else:
            self._samples.ledger.arrive(IN_MAP, stamp_ns)

    def _on_settled(self) -> None:
        """Tell how far it is, and what is missing once that is more than before."""
        state = self._samples.ledger.state
        if state.incomplete > self._warned and not self._samples.ledger.open:
            self._warned = state.incomplete
            self.get_logger().warning(shortfall(state.since(self._before_map)))
        self._publish_status()

    def _on_labels(self, message: SemanticLabels) -> None:
        self._class_names = {label.id: label.name for label in message.labels}

    def _give_up_color(self) -> None:
        are_told = self.count_publishers(SAMPLE_INFO_TOPIC) > 0
        give_up = partial(self._assembler.give_up_color, ends_are_told=are_told)
        self._take_in(give_up, time.monotonic())

    def _take_in(self, add: Callable[[Any], None], message: Any) -> None:
        """Give a message to the assembler and queue all frames that it completed."""
        with self._input_lock:
            try:
                add(message)
            except OaisysError as error:
                self.get_logger().warning(f"a message cannot be used: {error}")
            while self._fuse_next():
                pass

    def _fuse_next(self) -> bool:
        """Queue the next complete frame; return whether there was one."""
        try:
            frame = self._assembler.pop()
        except OaisysError as error:
            self.get_logger().warning(f"a frame cannot be used: {error}")
            return True
        if frame is None:
            return False
        if frame.stamp_ns >= self._batch_begin_ns:
            self._newest.append(frame)
            self._fuse(frame)
        return True

    def _fuse(self, frame: DepthFrame) -> None:
        if not self._fusion.add(frame):
            self.get_logger().warning("the queue is full: a frame is dropped")

    def _on_batch(self, message: SampleInfo) -> None:
        """Forget what was seen of the world before, whenever it is that this message comes."""
        batch = (message.config_sha256, message.seed, message.batch_id)
        with self._input_lock:
            known, self._batch = self._batch, batch
            if known in (None, batch):
                return
            self._batch_begin_ns = nanoseconds(message.header.stamp)
            # Said first: whoever sees the empty map finds the reason.
            number = message.batch_id
            self.get_logger().info(f"batch {number}: the map of the one before is cleared")
            self._forget_map(self._batch_begin_ns)
            for frame in list(self._newest):
                if frame.stamp_ns >= self._batch_begin_ns:
                    self._fuse(frame)

    def _offer_services(self, mesh_period_s: float) -> None:
        """Offer services, and meshes from time to time, in a group that may wait for frames."""
        group = MutuallyExclusiveCallbackGroup()
        for kind, name, callback in (
            (SaveMesh, "~/save_mesh", self._on_save_mesh),
            (Evaluate, "~/evaluate", self._on_evaluate),
            (Trigger, "~/reset", self._on_reset),
        ):
            self.create_service(kind, name, callback, callback_group=group)
        if mesh_period_s > 0:
            self.create_timer(
                mesh_period_s, self._publish_new_mesh, callback_group=group, clock=OWN_CLOCK
            )

    def _on_save_mesh(self, request: SaveMesh.Request, response: SaveMesh.Response) -> Any:
        try:
            path = Path(request.path)
            path.parent.mkdir(parents=True, exist_ok=True)
            with self._settled() as volume:
                mesh = volume.extract_mesh()
                if path.suffix == VOLUME_SUFFIX:
                    volume.save(path)
                views = self._fusion.views
            if path.suffix != VOLUME_SUFFIX:
                write_ply(path, mesh, self._class_names if mesh.class_ids is not None else None)
        except (OaisysError, OSError) as error:
            response.message = str(error)
            return response
        response.success = True
        response.message = self._shortfall
        response.frames = len(views)
        response.vertices = len(mesh.vertices_m)
        response.triangles = len(mesh.triangles)
        self._publish_mesh(mesh)
        return response

    def _on_evaluate(self, request: Evaluate.Request, response: Evaluate.Response) -> Any:
        try:
            truth = read_truth(Path(request.truth_path))
            with self._settled() as volume:
                views = self._fusion.views
                if not views:
                    raise NotReadyError("nothing has been mapped yet")
                found = evaluate_reconstruction(
                    volume.extract_mesh(),
                    truth,
                    views,
                    self._config.voxel_size_m,
                    self._config.max_range_m,
                    np.random.default_rng(EVALUATION_SEED),
                    Extras(
                        volume=volume,
                        labels=self._class_names,
                        classes=volume if self._config.semantic else None,
                    ),
                )
        except OaisysError as error:
            response.message = str(error)
            return response
        self._metrics_json = json.dumps(found.metrics.to_dict())
        response.success = True
        response.message = self._shortfall
        response.metrics_json = self._metrics_json
        self._publish_status()
        return response

    @contextmanager
    def _settled(self) -> Iterator[TsdfVolume]:
        """Lend the volume, with all samples in it that were announced so far.

        Raises:
            DeadlineExceededError: The fate of some of them is open after ``settle_timeout``.
        """
        timeout_s = self.parameters["settle_timeout"]
        end_s = time.monotonic() + timeout_s
        self._take_announcements()
        missing = self._samples.ledger.wait(timeout_s)
        if missing:
            raise DeadlineExceededError(
                f"{len(missing)} announced samples were not in the map within {timeout_s:g} s, "
                f"from {missing[0]} on"
            )
        with self._fusion.settled(max(end_s - time.monotonic(), 0.0)) as volume:
            yield volume

    def _take_announcements(self) -> None:
        """Take what waits of ``sample_info``: all that came before a request counts for it."""
        waiting = self._announcements
        while True:
            with waiting.handle:
                taken = waiting.handle.take_message(waiting.msg_type, waiting.raw)
            if taken is None:
                return
            waiting.callback(taken[0])

    @property
    def _shortfall(self) -> str:
        return shortfall(self._samples.ledger.state.since(self._before_map))

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        with self._input_lock:
            self._assembler.clear()
            self._newest.clear()
            self._forget_map()
        response.success = True
        return response

    def _forget_map(self, before_ns: int | None = None) -> None:
        """Begin anew, and expect no sample any more that was taken before."""
        self._metrics_json = ""
        self._samples.ledger.forget(before_ns)
        self._before_map = self._samples.ledger.state
        self._fusion.reset()

    def _publish_status(self) -> None:
        with self._status_lock:  # an older state must not follow a newer one
            state = self._fusion.state
            samples = self._samples.ledger.state.since(self._before_map)
            stamp = Time(nanoseconds=state.stamp_ns).to_msg()
            status = MapStatus(
                header=Header(stamp=stamp, frame_id=self._map_frame),
                frames_received=state.received,
                frames_integrated=state.integrated,
                frames_dropped=state.dropped + self._assembler.given_up,
                integration_time=state.integration_time_s,
                metrics_json=self._metrics_json,
                samples_announced=samples.announced,
                samples_incomplete=samples.incomplete,
                lost=losses_msg(samples.lost),
            )
            if status != self._told:
                self._told = status
                self._status_publisher.publish(status)

    def _publish_new_mesh(self) -> None:
        """Publish the surface if it has grown and somebody listens."""
        publishers = (self._mesh_publisher, self._points_publisher)
        listeners = sum(publisher.get_subscription_count() for publisher in publishers)
        integrated = self._fusion.state.integrated
        if listeners == 0 or integrated == self._published_frames:
            return
        try:
            mesh = self._fusion.visible_surface()
        except OaisysError as error:
            self.get_logger().warning(f"no mesh: {error}")
            return
        self._publish_mesh(mesh)
        self._published_frames = integrated

    def _publish_mesh(self, mesh: ColoredMesh) -> None:
        stamp = Time(nanoseconds=self._fusion.state.stamp_ns).to_msg()
        header = Header(stamp=stamp, frame_id=self._map_frame)
        if self.parameters["mesh_colors"] == "class" and mesh.class_ids is not None:
            mesh = replace(mesh, colors_rgb=class_colors(mesh.class_ids))
        points = mesh.vertices_m.astype("float32")[None]
        self._points_publisher.publish(cloud_to_msg(points, mesh.colors_rgb[None], header))
        small = at_most(mesh, self.parameters["mesh_triangles"], 2 * self._config.voxel_size_m)
        self._mesh_publisher.publish(
            mesh_to_marker(small.vertices_m, small.triangles, small.colors_rgb, header)
        )


def _stamps_of(message: Any) -> Sequence[int]:
    """Return the stamps that a message is of; announcements and mounts are of none."""
    if isinstance(message, TFMessage):
        return [nanoseconds(each.header.stamp) for each in message.transforms]
    return () if isinstance(message, SampleInfo) else (nanoseconds(message.header.stamp),)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is told to end."""
    keep_freed_memory()
    return run_node(MapperNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
