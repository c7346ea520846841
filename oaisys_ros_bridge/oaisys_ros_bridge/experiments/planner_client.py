"""The ROS client of a view planner: asks the bridge for views and receives what it publishes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from rclpy.action import ActionClient
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from oaisys_core.errors import DeadlineExceededError, RenderError
from oaisys_core.types import Pose
from oaisys_msgs.action import Sweep
from oaisys_msgs.srv import SaveMesh, SetPose, StepBatch
from oaisys_ros_bridge.conversions import image_from_msg, nanoseconds, pose_to_stamped_msg
from oaisys_ros_bridge.experiments.status import DISCOVERY_TIMEOUT_S, StackStatus
from oaisys_ros_bridge.namespaces import namespace_arguments
from oaisys_ros_bridge.nodes.background_node import BackgroundNode, result_of
from oaisys_ros_bridge.qos import DEEP_QOS
from oaisys_ros_bridge.topic_names import TOPIC_BY_MODALITY

ARRIVAL_TIMEOUT_S = 20.0
"""From the answer of ``set_pose`` until all images of its sample are received."""

Images = Mapping[str, NDArray[Any]]
"""Images of one sample by modality."""

Stamp = tuple[int, int]
"""Seconds and nanoseconds of a sample's stamp."""


@dataclass(frozen=True)
class ReceivedView:
    """One view as a planner receives it.

    Attributes:
        images: By modality.
        render_s: How long the simulator says that rendering took.
        service_s: From the call to the answer.
        stamp_ns: Of the sample.
        transfer_s: How long the bridge waited for the sample beside its rendering; 0: not known.
        integration_s: How long the mapper says that fusing took; 0: not known.
    """

    images: Images
    render_s: float
    service_s: float
    stamp_ns: int = 0
    transfer_s: float = 0.0
    integration_s: float = 0.0


class PlannerClient(BackgroundNode):
    """A node that calls the bridge and the mapper; a context manager.

    Attributes:
        status: The state of bridge, mapper and recorder.
    """

    def __init__(
        self, namespace: str, modalities: tuple[str, ...], ros_namespace: str = ""
    ) -> None:
        """Initialise rclpy and join the ROS graph.

        Args:
            namespace: Prefix of the camera's topics.
            modalities: Whose images to wait for after each view.
            ros_namespace: Of bridge and mapper.
        """
        super().__init__("oaisys_survey", namespace_arguments(ros_namespace))
        self._images: dict[Stamp, dict[str, NDArray[Any]]] = {}
        self._modalities = modalities
        self._last_stamp_ns = 0
        for modality in modalities:
            self._subscribe_to_images(namespace, modality)
        # Before the subscriptions of the status, which is waited for: nodes discover each other's
        # endpoints in the order in which they were made, and Fast DDS drops a service's answers to
        # a client that the service has not discovered yet.
        self._set_pose = self.node.create_client(SetPose, "oaisys_bridge/set_pose")
        self._save_mesh = self.node.create_client(SaveMesh, "oaisys_mapper/save_mesh")
        self._step_batch = self.node.create_client(StepBatch, "oaisys_bridge/step_batch")
        self._sweep = ActionClient(self.node, Sweep, "oaisys_bridge/sweep")
        self.status = StackStatus(self)
        self.start()

    def wait_for_mapper(self) -> None:
        """Wait until the mapper offers its services, and has discovered this node.

        Raises:
            DeadlineExceededError: It has not in time.
        """
        _require_service(self._save_mesh)
        self.status.wait_for_mapper()

    def step_batch(self, seed: int, timeout_s: float) -> None:
        """Have the simulator build the world of a seed.

        Raises:
            RenderError: It could not.
            DeadlineExceededError: No answer in time.
        """
        answer = self._call(self._step_batch, StepBatch.Request(seed=seed), timeout_s)
        if not answer.success:
            raise RenderError(f"step_batch failed: {answer.message}")

    def view(self, pose: Pose, sensor: str, map_frame: str, timeout_s: float) -> ReceivedView:
        """Have the simulator render from ``pose`` and return what was published.

        Args:
            pose: Of the rig, or of ``sensor`` where one is named.
            sensor: Name of a sensor, or empty.
            map_frame: Frame of the pose.
            timeout_s: Until the service must have answered.

        Raises:
            RenderError: The bridge refused or failed; holds its message.
            DeadlineExceededError: No answer, or not all images, in time; or a second bridge of that
                name has been discovered.
        """
        self.status.require_one_bridge()
        request = SetPose.Request(sensor=sensor, modalities=list(self._modalities))
        request.pose = pose_to_stamped_msg(pose, Header(frame_id=map_frame))
        started_s = time.monotonic()
        answer: SetPose.Response = self._call(self._set_pose, request, timeout_s)
        service_s = time.monotonic() - started_s
        if not answer.success:
            raise RenderError(f"set_pose failed: {answer.message}")
        stamp = _key(answer.stamp)
        self.wait(
            f"the images of sample {answer.sample_id}",
            lambda: self._has_images(stamp),
            ARRIVAL_TIMEOUT_S,
        )
        self._last_stamp_ns = nanoseconds(answer.stamp)
        images = self._pop_images(stamp)
        return ReceivedView(images, answer.render_time, service_s, self._last_stamp_ns)

    def shortfalls(self, timeout_s: float) -> list[str]:
        """Wait until mapper and recorder have received the last view; return what they lost."""
        return self.status.shortfalls(self._last_stamp_ns, timeout_s)

    def sweep(self, poses: Sequence[Pose], map_frame: str, timeout_s: float) -> Sweep.Result:
        """Have the simulator render from many poses without a pause; keep no images.

        Raises:
            RenderError: A pose failed; holds its message.
            DeadlineExceededError: It has not ended in time; or there are two bridges of that name.
        """
        self.status.require_one_bridge()
        if not self._sweep.wait_for_server(DISCOVERY_TIMEOUT_S):
            raise DeadlineExceededError(
                f"the bridge offered no sweep within {DISCOVERY_TIMEOUT_S:g} s"
            )
        header = Header(frame_id=map_frame)
        stamped = [pose_to_stamped_msg(pose, header).pose for pose in poses]
        goal = Sweep.Goal(poses=PoseArray(header=header, poses=stamped))
        sent = self.send(lambda: self._sweep.send_goal_async(goal), "sweep", DISCOVERY_TIMEOUT_S)
        handle = result_of(sent, "sweep", DISCOVERY_TIMEOUT_S)
        answer = self.send(handle.get_result_async, "sweep", timeout_s)
        result: Sweep.Result = result_of(answer, "sweep", timeout_s).result
        if not result.success:
            raise RenderError(f"sweep failed: {result.message}")
        return result

    def save_mesh(self, path: str, timeout_s: float) -> SaveMesh.Response:
        """Have the mapper write its mesh and return its answer.

        Raises:
            RenderError: It could not, or the map is empty.
            DeadlineExceededError: No answer in time.
        """
        answer = self._call(self._save_mesh, SaveMesh.Request(path=path), timeout_s)
        if not answer.success:
            raise RenderError(f"save_mesh failed: {answer.message}")
        if not answer.triangles:
            views = f"no view ({answer.frames} of them) saw ground within the range that is mapped"
            raise RenderError(f"the map is empty: {views}")
        return answer

    def _call(self, client: Any, request: Any, timeout_s: float) -> Any:
        _require_service(client)
        return result_of(client.call_async(request), client.srv_name, timeout_s)

    def _subscribe_to_images(self, namespace: str, modality: str) -> None:
        def keep(message: Image) -> None:
            images = self._images.setdefault(_key(message.header.stamp), {})
            images[modality] = image_from_msg(message)

        topic = f"{namespace}/{TOPIC_BY_MODALITY.get(modality, modality)}/image_raw"
        self.subscribe(Image, topic, keep, DEEP_QOS)

    def _has_images(self, stamp: Stamp) -> bool:
        """Return whether the images of all modalities have been received."""
        return len(self._images.get(stamp, ())) >= len(self._modalities)

    def _are_lost(self, stamp: Stamp) -> bool:
        """Return whether a later sample is complete: images of a topic come in their order."""
        return any(each > stamp and self._has_images(each) for each in self._images)

    def _pop_images(self, stamp: Stamp) -> Images:
        """Return the images of a sample; forget it, and older ones that never became complete."""
        with self.changed:
            images = self._images.pop(stamp)
            self._images = {k: v for k, v in self._images.items() if k > stamp}
            return images


def _require_service(client: Any) -> None:
    if not client.wait_for_service(DISCOVERY_TIMEOUT_S):
        raise DeadlineExceededError(
            f"{client.srv_name} was not offered within {DISCOVERY_TIMEOUT_S:g} s"
        )


def _key(stamp: Time) -> Stamp:
    return stamp.sec, stamp.nanosec
