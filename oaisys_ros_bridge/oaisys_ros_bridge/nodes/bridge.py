"""Node ``oaisys_bridge``: pose requests in, samples of the simulator out."""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time as TimeMsg
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Bool, Header
from std_srvs.srv import Trigger

from oaisys_core.errors import InvalidInputError, NotReadyError, OaisysError
from oaisys_core.types import (
    Frame,
    ModuleMetadata,
    Pose,
    Sample,
    SampleFramesCallback,
    SampleOutline,
    SimulatorInfo,
)
from oaisys_grpc.client import client_tls
from oaisys_msgs.msg import SampleInfo
from oaisys_msgs.srv import SetMetadata, SetPose, StepBatch
from oaisys_ros_bridge.node_process import run_node
from oaisys_ros_bridge.publication import Publication
from oaisys_ros_bridge.qos import LATCHED_QOS, NEWEST_QOS
from oaisys_ros_bridge.requests import (
    checked_modalities,
    metadata_of_module,
    metadata_of_modules,
    rig_pose,
)
from oaisys_ros_bridge.sample_info import batch_info_msg
from oaisys_ros_bridge.sample_publisher import SamplePublisher
from oaisys_ros_bridge.simulator_link import LinkState, SimulatorLink


class BridgeNode(Node):
    """Renders where it is asked to, one request at a time, and publishes what comes back.

    Parameters:
        address: Of the simulator's gRPC server.
        initial_batch: Whether to build a first batch where the server has none.
        publish_points: Whether to offer clouds.
        map_frame, base_frame: Frames of the world and of the rig.
        timeout_s: Longest time that a call to the server may take.
        tls_ca, tls_cert, tls_key: PEM files for a server that encrypts: authorities of its
            certificate, and this client's own; all empty: without TLS.
    """

    def __init__(self) -> None:
        super().__init__("oaisys_bridge")
        address = self.declare_parameter("address", "127.0.0.1:50051").value
        initial_batch = self.declare_parameter("initial_batch", True).value
        timeout_s = self.declare_parameter("timeout_s", 600.0).value
        tls_files = [self.declare_parameter(f"tls_{n}", "").value for n in ("ca", "cert", "key")]
        self._publish_points = self.declare_parameter("publish_points", True).value
        self._map_frame = self.declare_parameter("map_frame", "map").value
        self._base_frame = self.declare_parameter("base_frame", "base_link").value
        self._metadata: ModuleMetadata | None = None
        self._metadata_lock = threading.Lock()
        self._last_stamp_ns = 0
        self._last_render_s = float("nan")
        self._samples: SamplePublisher | None = None
        self._announced_batch: tuple[str, int, int] | None = None
        self._ready = self.create_publisher(Bool, "~/ready", LATCHED_QOS)
        self._batch = self.create_publisher(SampleInfo, "~/batch", LATCHED_QOS)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._link = SimulatorLink(
            address,
            initial_batch=initial_batch,
            timeout_s=timeout_s,
            on_change=self._follow,
            tls=client_tls(*tls_files),
        )
        self._create_interfaces()
        self._ready.publish(Bool(data=False))
        self._link.start()

    def close(self) -> None:
        """Let go of the simulator."""
        self._link.close()

    def _create_interfaces(self) -> None:
        """Offer the services; each waits for the simulator in a group of its own."""
        services = (
            (SetPose, "~/set_pose", self._on_set_pose),
            (StepBatch, "~/step_batch", self._on_step_batch),
            (SetMetadata, "~/set_metadata", self._on_set_metadata),
            (Trigger, "~/end_simulation", self._on_end_simulation),
        )
        for kind, name, callback in services:
            group = MutuallyExclusiveCallbackGroup()
            self.create_service(kind, name, callback, callback_group=group)
        # While one command renders, its queue of one keeps only the newest of those that follow.
        self.create_subscription(
            PoseStamped,
            "command/pose",
            self._on_command_pose,
            NEWEST_QOS,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self.create_timer(
            1.0, self._publish_diagnostics, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def _on_set_pose(self, request: SetPose.Request, response: SetPose.Response) -> Any:
        try:
            sample, stamp = self._render(request.pose, request.sensor, request.modalities)
        except OaisysError as error:
            response.message = str(error)
            self.get_logger().warning(f"set_pose refused: {error}")
            return response
        response.success = True
        response.batch_id = sample.batch_id
        response.sample_id = sample.sample_id
        response.stamp = stamp
        response.render_time = sample.render_time_s
        return response

    def _on_command_pose(self, pose: PoseStamped) -> None:
        try:
            self._render(pose, "", ())
        except OaisysError as error:
            self.get_logger().warning(f"command/pose refused: {error}")

    def _on_step_batch(self, request: StepBatch.Request, response: StepBatch.Response) -> Any:
        try:
            if request.seed < -1:
                raise InvalidInputError("seed", request.seed, "0 or more, or -1 for the next")
            response.batch_id = self._link.step_batch(
                seed=None if request.seed == -1 else request.seed,
                reuse_stage=request.reuse_stage,
                metadata=metadata_of_modules(request.metadata_json),
            )
            response.success = True
        except OaisysError as error:
            response.message = str(error)
            self.get_logger().warning(f"step_batch refused: {error}")
        return response

    def _on_set_metadata(self, request: SetMetadata.Request, response: SetMetadata.Response) -> Any:
        try:
            later = metadata_of_module(request.module, request.metadata_json)
            with self._metadata_lock:
                self._metadata = (self._metadata or ModuleMetadata()).updated(later)
            response.success = True
            response.message = "takes effect at the next sample"
        except OaisysError as error:
            response.message = str(error)
        return response

    def _on_end_simulation(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        try:
            self._link.end_simulation()
            response.success = True
        except OaisysError as error:
            response.message = str(error)
        return response

    def _render(
        self, pose: PoseStamped, sensor: str, modalities: Sequence[str]
    ) -> tuple[Sample, TimeMsg]:
        """Render and publish one sample; requests go one at a time, so stamps only increase.

        What is ready goes out at once. Where the render then fails, ``~/sample_info`` never tells
        of that stamp: its images belong to no sample.
        """
        with self._link.lock:
            info = self._link.state.info
            if info is None:
                self._link.check()
                info = self._link.state.info
            if info is None:
                raise NotReadyError(self._link.state.reason)
            target = rig_pose(pose, sensor, info, self._map_frame)
            wanted = checked_modalities(modalities, sensor, info)
            begun: list[Publication] = []

            def publish(outline: SampleOutline, frames: tuple[Frame, ...]) -> None:
                if not begun:
                    begun.append(self._begin(outline))
                begun[0].add(frames)

            sample = self._render_at(target, wanted, [sensor] if sensor else [], publish)
            self._last_render_s = sample.render_time_s
            publication = begun[0] if begun else self._begin(sample.outline)
            publication.finish(sample)
            return sample, publication.stamp

    def _begin(self, outline: SampleOutline) -> Publication:
        """Begin to publish a sample, with a stamp after that of its batch."""
        self._notice_batch(outline.batch_id)
        if self._samples is None:
            raise NotReadyError(self._link.state.reason)
        return Publication(self._samples, outline, self._next_stamp())

    def _render_at(
        self,
        pose: Pose,
        modalities: list[str],
        sensors: list[str],
        on_frames: SampleFramesCallback,
    ) -> Sample:
        """Render with what was set since the last sample; the simulator keeps it from then on.

        Metadata that it refuses is forgotten: it would spoil every later sample.
        """
        with self._metadata_lock:
            metadata, self._metadata = self._metadata, None
        try:
            return self._link.render(
                pose,
                metadata=metadata,
                modalities=modalities,
                sensors=sensors,
                on_frames=on_frames,
            )
        except OaisysError as error:
            refused = isinstance(error, InvalidInputError) and "pose" not in error.field
            if metadata is not None and not refused:
                with self._metadata_lock:
                    self._metadata = metadata.updated(self._metadata or ModuleMetadata())
            raise

    def _next_stamp(self) -> TimeMsg:
        """Return now, or a nanosecond after the stamp before where the clock has not moved on."""
        now_ns = self.get_clock().now().nanoseconds
        self._last_stamp_ns = max(now_ns, self._last_stamp_ns + 1)
        return Time(nanoseconds=self._last_stamp_ns).to_msg()

    def _follow(self, before: LinkState, state: LinkState) -> None:
        """Offer the topics of the simulator that was found and say whether it is ready."""
        if state.info is not None:
            self._offer_topics_of(state.info)
            self._announce_batch_of(state.info)
        if state.ready != before.ready:
            self._ready.publish(Bool(data=state.ready))
        if state.reason == before.reason:
            return
        self._publish_diagnostics()
        if state.info is not None:
            self.get_logger().info(f"simulator at {self._link.address}: {state.reason or 'ready'}")
        else:
            self.get_logger().warning(f"simulator lost: {state.reason}")

    def _notice_batch(self, batch_id: int) -> None:
        """Look at the simulator before a sample of a batch that another client has stepped."""
        info = self._link.state.info
        if info is None or info.batch_id != batch_id:
            self._link.check()

    def _announce_batch_of(self, info: SimulatorInfo) -> None:
        """Say that another world stands: what was published before shows the old one."""
        batch = (info.config_sha256, info.seed, info.batch_id)
        if info.batch_id == 0 or batch == self._announced_batch:
            return
        self._announced_batch = batch
        header = Header(stamp=self._next_stamp(), frame_id=self._map_frame)
        self._batch.publish(batch_info_msg(info, header))

    def _offer_topics_of(self, info: SimulatorInfo) -> None:
        if self._samples is not None and self._samples.fits(info):
            self._samples.update(info)
            return
        if self._samples is not None:
            self._samples.destroy()
        self._samples = SamplePublisher(
            self,
            info,
            map_frame=self._map_frame,
            base_frame=self._base_frame,
            publish_points=self._publish_points,
        )

    def _publish_diagnostics(self) -> None:
        state = self._link.state
        level = DiagnosticStatus.OK if state.ready else DiagnosticStatus.ERROR
        values = {
            "address": self._link.address,
            "connected": str(state.info is not None).lower(),
            "connections": str(state.connections),
            "last_render_s": f"{self._last_render_s:.4f}",
        }
        for publisher in self.publishers:
            # A caller that must not lose the first sample waits until its subscribers are known.
            values[f"subscribers {publisher.topic_name}"] = str(publisher.get_subscription_count())
        if state.info is not None:
            values["backend"] = f"{state.info.backend} {state.info.backend_version}"
            values["batch_id"] = str(state.info.batch_id)
            values["worker_restarts"] = str(state.info.worker_restarts)
        status = DiagnosticStatus(
            level=level,
            name=f"{self.get_name()}: simulator",
            message=state.reason or "ready",
            hardware_id=self._link.address,
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is told to end."""
    return run_node(BridgeNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
