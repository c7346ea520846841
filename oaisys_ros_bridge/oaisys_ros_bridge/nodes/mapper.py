"""Node ``oaisys_mapper``: rebuilds the surface from depth images, cameras and transforms."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.node import Node
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from oaisys_core.errors import DeadlineExceededError, NotReadyError, OaisysError
from oaisys_core.files.folders import user_file, user_path
from oaisys_core.files.whole_files import check_output_file
from oaisys_grpc.memory import keep_freed_memory
from oaisys_mapping.mesh_io import write_ply
from oaisys_msgs.msg import MapStatus
from oaisys_msgs.srv import Evaluate, SaveMesh
from oaisys_ros_bridge.conversions import stamp_from_nanoseconds
from oaisys_ros_bridge.mapper.esdf_topic import EsdfTopic
from oaisys_ros_bridge.mapper.fusion import Fusion
from oaisys_ros_bridge.mapper.inputs import IN_MAP, SAMPLE_INFO_TOPIC, MapperInputs
from oaisys_ros_bridge.mapper.mapped_ground import MappedGround
from oaisys_ros_bridge.mapper.mesh_topics import MeshTopics
from oaisys_ros_bridge.nodes.node_process import run_node
from oaisys_ros_bridge.nodes.program_arguments import node_parser, parse_arguments
from oaisys_ros_bridge.parameters.mapper import MAPPER, tsdf_config
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.publishing.ground_topics import GroundTopics
from oaisys_ros_bridge.qos import LATCHED_QOS
from oaisys_ros_bridge.services import RequestQueue, close_queues
from oaisys_ros_bridge.subscribing.ledger_state import LedgerState, shortfall
from oaisys_ros_bridge.subscribing.sample_ledger import LOST_AFTER_S
from oaisys_ros_bridge.subscribing.sample_watch import SampleWatch, losses_msg
from oaisys_ros_bridge.timers import steady_timer

if TYPE_CHECKING:
    from oaisys_mapping.tsdf import TsdfVolume

MESH_SUFFIX = ".ply"
VOLUME_SUFFIX = ".npz"
"""Suffixes with which ``~/save_mesh`` writes the mesh, or the whole volume."""

ANSWER_S = 3.0
"""For the bridge to say which sample is the last."""

EVALUATION_SEED = 0
"""Of the random points that are measured: the same map gets the same figures."""


class MapperNode(ParameterNode, Node):
    """Fuses every depth image whose camera and pose carry the same stamp.

    Its parameters are the table `MAPPER`. Every input is a relative topic and can be remapped
    alone, for instance from nvblox's ``camera_0/depth/image``: below the camera's prefix
    ``depth/image_raw`` (``32FC1`` metres or ``16UC1`` millimetres), ``depth/camera_info``,
    ``color/image_raw`` and ``color/camera_info`` of the same camera, ``semantic_0/image_raw`` and
    ``semantic_0/labels``; poses from ``/tf`` or ``ground_truth/odometry``.

    Every sample that is announced on ``oaisys_bridge/sample_info`` with a depth image of the camera
    is expected in the map. The node reports what has become of it on ``oaisys_bridge/receipts``,
    for which the bridge waits, and what is missing in ``~/metrics`` and by the services.

    Where the bridge announces complete samples, depth images of incomplete ones are dropped.
    Without colour and classes, depth images are fused at once.
    """

    def __init__(self) -> None:
        super().__init__("oaisys_mapper")
        values = self.declare_table(MAPPER)
        self._config = tsdf_config(values)
        self._metrics_json = ""
        self._unheard = ""
        self._before_map = LedgerState()
        self._warned = 0
        self._published_status: MapStatus | None = None
        self._status_lock = threading.Lock()
        self._status_publisher = self.create_publisher(MapStatus, "~/metrics", LATCHED_QOS)
        lost_by_middleware: Counter[str] = Counter()
        self._samples = SampleWatch(
            self,
            self.resolve_topic_name(SAMPLE_INFO_TOPIC),
            lost_by_middleware,
            on_settled=self._on_settled,
        )
        self._fusion = Fusion(
            self._config,
            on_change=lambda _: self._publish_status(),
            on_error=self.get_logger().warning,
            on_done=self._on_fused,
        )
        self._mesh_topics = MeshTopics(self, self._fusion, lambda: self.parameters)
        ground = MappedGround(self._fusion)
        self._ground_topics = GroundTopics(
            self, "~/", ground.newest_view, ground.find, lambda: self.parameters
        )
        EsdfTopic(self, self._fusion, ground.newest_view, lambda: self.parameters)
        self._inputs = MapperInputs(
            self,
            values,
            self._samples.ledger,
            self._fusion,
            lost_by_middleware,
            self._forget_map,
        )
        self._samples.begin(time.time_ns())
        self._requests = RequestQueue(self)
        self._offer_services(values["mesh_period"])
        self._publish_status()

    def close(self) -> None:
        """Send the last receipt, end the fusion's thread, answer all requests."""
        self._samples.end()
        self._fusion.close()
        close_queues([self._requests])

    def _on_fused(self, stamp_ns: int, fault: str) -> None:
        """Note in the ledger what has become of a frame."""
        if fault:
            self._samples.ledger.give_up(stamp_ns, fault)
        else:
            self._samples.ledger.arrive(IN_MAP, stamp_ns)
            self._ground_topics.note_view()

    def _on_settled(self) -> None:
        """Publish the status; warn when more is missing than before."""
        state = self._samples.state
        if state.incomplete > self._warned and not self._samples.ledger.open:
            self._warned = state.incomplete
            self.get_logger().warning(shortfall(state.since(self._before_map)))
        self._publish_status()

    def _offer_services(self, mesh_period_s: float) -> None:
        """Offer services and publish meshes now and then, one at a time: each waits for frames."""
        for kind, name, callback in (
            (SaveMesh, "~/save_mesh", self._on_save_mesh),
            (Evaluate, "~/evaluate", self._on_evaluate),
            (Trigger, "~/reset", self._on_reset),
        ):
            self._requests.offer(kind, name, callback)
        if mesh_period_s > 0:
            steady_timer(self, mesh_period_s, self._publish_mesh)

    def _publish_mesh(self) -> None:
        """Publish what is new of the mesh, unless a request is being served."""
        if not self._requests.is_busy:
            self._requests.submit(self._mesh_topics.publish_new)

    def _on_save_mesh(self, request: SaveMesh.Request, response: SaveMesh.Response) -> Any:
        try:
            path = user_file(request.path, "path", (MESH_SUFFIX, VOLUME_SUFFIX))
            is_volume = path.suffix.lower() == VOLUME_SUFFIX
            with self._settle() as volume:
                views = self._fusion.views
                if not views:
                    raise NotReadyError("nothing has been mapped yet")
                mesh = volume.extract_mesh()
                check_output_file(path, "path")
                if is_volume:
                    volume.save(path)
            if not is_volume:
                write_ply(
                    path, mesh, self._inputs.class_names if mesh.class_ids is not None else None
                )
        except (OaisysError, OSError, ValueError) as error:
            response.message = str(error)
            return response
        response.success = True
        response.message = self._shortfall
        response.frames = len(views)
        response.vertices = len(mesh.vertices_m)
        response.triangles = len(mesh.triangles)
        self._mesh_topics.publish(mesh)
        return response

    def _on_evaluate(self, request: Evaluate.Request, response: Evaluate.Response) -> Any:
        # Open3D is imported on the fusion's thread, while the node begins to listen.
        from oaisys_mapping.evaluation.evaluate import Extras, evaluate_reconstruction
        from oaisys_mapping.evaluation.truth_io import read_truth

        try:
            truth = read_truth(user_path(request.truth_path, "truth_path"))
            with self._settle() as volume:
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
                        labels=self._inputs.class_names,
                        classes=volume if self._config.semantic else None,
                    ),
                )
        except (OaisysError, OSError, ValueError) as error:
            response.message = str(error)
            return response
        self._metrics_json = json.dumps(found.metrics.to_dict())
        response.success = True
        response.message = self._shortfall
        response.metrics_json = self._metrics_json
        self._publish_status()
        return response

    @contextmanager
    def _settle(self) -> Iterator[TsdfVolume]:
        """Lend the volume once all samples that were announced so far are in it.

        Raises:
            DeadlineExceededError: Some of them are neither in it nor lost after ``settle_timeout``.
        """
        timeout_s = self.parameters["settle_timeout"]
        end_s = time.monotonic() + timeout_s
        self._hear_announcements()
        missing = self._samples.ledger.wait(timeout_s)
        if missing:
            raise DeadlineExceededError(
                f"{len(missing)} announced samples were not in the map within {timeout_s:g} s, "
                f"from {missing[0]} on"
            )
        with self._fusion.settle(max(end_s - time.monotonic(), 0.0)) as volume:
            yield volume

    def _hear_announcements(self) -> None:
        """Take the announcements of all samples and worlds so far, or note what may be missing."""
        self._inputs.take_announcements()
        heard = self._samples.hear_newest(ANSWER_S)
        late_world = self._inputs.hear_world(heard.batch_begin_ns, LOST_AFTER_S)
        self._unheard = "; ".join(filter(None, (heard.doubt, late_world)))

    @property
    def _shortfall(self) -> str:
        lost = shortfall(self._samples.state.since(self._before_map))
        return "; ".join(filter(None, (lost, self._unheard)))

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Any:
        # What comes later of a sample so far would be the first of the new map.
        self._hear_announcements()
        self._samples.ledger.wait(self.parameters["settle_timeout"])
        self._inputs.clear()
        self._forget_map()
        response.success = True
        return response

    def _forget_map(self, before_ns: int | None = None) -> None:
        """Clear the map, and no longer expect the samples announced before."""
        self._metrics_json = ""
        self._samples.ledger.forget(before_ns)
        self._before_map = self._samples.state
        self._fusion.reset()

    def _publish_status(self) -> None:
        with self._status_lock:  # an older state must not follow a newer one
            state = self._fusion.state
            samples = self._samples.state.since(self._before_map)
            stamp = stamp_from_nanoseconds(state.stamp_ns)
            status = MapStatus(
                header=Header(stamp=stamp, frame_id=self.parameters["map_frame"]),
                frames_received=state.received,
                frames_integrated=state.integrated,
                frames_dropped=state.dropped + self._inputs.dropouts,
                integration_time=state.integration_time_s,
                metrics_json=self._metrics_json,
                samples_announced=samples.announced,
                samples_incomplete=samples.incomplete,
                lost=losses_msg(samples.lost),
                lost_by_middleware=losses_msg(samples.lost_by_middleware),
            )
            if status != self._published_status:
                self._published_status = status
                self._status_publisher.publish(status)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is told to end."""
    _, arguments = parse_arguments(node_parser("mapper"), arguments)
    keep_freed_memory()
    return run_node(MapperNode, arguments)


if __name__ == "__main__":
    sys.exit(main())
