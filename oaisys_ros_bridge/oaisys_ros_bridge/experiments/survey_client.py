"""A planner's side of ROS: asks for views through ``set_pose`` and takes what is published."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Header

from oaisys_core.errors import DeadlineExceededError, RenderError
from oaisys_core.types import Pose
from oaisys_msgs.action import Sweep
from oaisys_msgs.msg import MapStatus, SampleReceipt
from oaisys_msgs.srv import SaveMesh, SetPose, StepBatch
from oaisys_ros_bridge.bridge.diagnostics import FIRST_BATCH_ERROR
from oaisys_ros_bridge.bridge.readers import state_of
from oaisys_ros_bridge.conversions import image_from_msg, pose_to_stamped_msg
from oaisys_ros_bridge.namespaces import placing_arguments
from oaisys_ros_bridge.publishing.sensor_topics import TOPIC_BY_MODALITY
from oaisys_ros_bridge.publishing.stamps import nanoseconds
from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS, LATCHED_QOS, SENSOR_QOS
from oaisys_ros_bridge.subscribing.sample_ledger import shortfall
from oaisys_ros_bridge.transport import prepare_transport

DISCOVERY_TIMEOUT_S = 30.0
ARRIVAL_TIMEOUT_S = 20.0
DIAGNOSTICS_DEPTH = 10
SUBSCRIBERS = "subscribers "
"""Begins the keys under which the bridge tells how many subscribers of a topic it has matched."""

Images = Mapping[str, NDArray[Any]]
"""Images of one sample by modality."""


@dataclass(frozen=True)
class ReceivedView:
    """One view as a planner gets it.

    Attributes:
        images: By modality.
        render_s: What the simulator says that rendering took.
        service_s: From the call to the answer.
        stamp_ns: Of the sample.
        transfer_s: What the bridge waited for it besides; 0 until that is known.
        integration_s: What the mapper says that fusing it took; 0 until that is known.
    """

    images: Images
    render_s: float
    service_s: float
    stamp_ns: int = 0
    transfer_s: float = 0.0
    integration_s: float = 0.0


class SurveyClient:
    """A node that calls the bridge and the mapper; use it in a ``with`` block."""

    def __init__(
        self, namespace: str, modalities: tuple[str, ...], ros_namespace: str = ""
    ) -> None:
        """Join ROS.

        Args:
            namespace: Prefix of the camera's topics.
            modalities: Whose images to wait for after each view.
            ros_namespace: In which bridge and mapper are.
        """
        prepare_transport()
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("oaisys_survey", cli_args=placing_arguments(ros_namespace))
        self._changed = threading.Condition()
        self._images: dict[tuple[int, int], dict[str, NDArray[Any]]] = {}
        self._modalities = modalities
        self._bridge_is_ready = False
        self._first_batch_errors: dict[str, str] = {}
        self._integration_s: dict[int, float] = {}
        self._map = MapStatus()
        self._receipts: dict[str, SampleReceipt] = {}
        self._last_stamp_ns = 0
        self._namespace = namespace
        for modality in modalities:
            take = self._take(modality)
            self._node.create_subscription(Image, self._topic(modality), take, SENSOR_QOS)
        # Before the subscriptions that are waited for: Fast DDS drops answers to a client that its
        # service does not know, and nodes get to know what a node has in the order it was made.
        self._set_pose = self._node.create_client(SetPose, "oaisys_bridge/set_pose")
        self._save_mesh = self._node.create_client(SaveMesh, "oaisys_mapper/save_mesh")
        self._step_batch = self._node.create_client(StepBatch, "oaisys_bridge/step_batch")
        self._sweep = ActionClient(self._node, Sweep, "oaisys_bridge/sweep")
        self._node.create_subscription(Bool, "oaisys_bridge/ready", self._on_ready, LATCHED_QOS)
        self._node.create_subscription(
            MapStatus, "oaisys_mapper/metrics", self._on_map_status, LATCHED_QOS
        )
        self._node.create_subscription(
            SampleReceipt, "oaisys_bridge/receipts", self._on_receipt, LATCHED_HISTORY_QOS
        )
        self._matched: dict[str, int] = {}
        self._transfer_s: dict[int, float] = {}
        self._node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, DIAGNOSTICS_DEPTH
        )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._spinner = threading.Thread(target=self._spin, name="survey executor", daemon=True)
        self._spinner.start()

    def __enter__(self) -> Self:
        """Return the joined node."""
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Leave ROS."""
        self._executor.shutdown(timeout_sec=2.0)
        rclpy.try_shutdown()
        self._spinner.join(timeout=2.0)

    def wait_for_bridge(
        self, timeout_s: float, check: Callable[[], None], address: str = ""
    ) -> None:
        """Wait until the bridge has a world to show.

        Args:
            timeout_s: How long.
            check: May raise to stop waiting.
            address: Of the bridge's simulator; empty: any.

        Raises:
            RenderError: It could not build one.
            DeadlineExceededError: It has none in time; or there are two bridges of that name.
        """

        def check_all() -> None:
            check()
            for simulator, error in self._first_batch_errors.items():
                if error and address in ("", simulator):
                    raise RenderError(error)

        self._wait(
            "the bridge to be ready",
            lambda: self._bridge_is_ready and self.bridges > 0,
            timeout_s,
            check_all,
        )
        self._wait_for_others_to_leave()

    @property
    def bridges(self) -> int:
        """How many bridges of that name are known of so far; more may be discovered later."""
        return int(self._node.count_publishers("oaisys_bridge/ready"))

    def _wait_for_others_to_leave(self) -> None:
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        self._wait(
            f"all bridges but ours to leave ROS domain {domain} (set another ROS_DOMAIN_ID)",
            lambda: self.bridges <= 1,  # none: ours has ended, as calls to it will tell
            DISCOVERY_TIMEOUT_S,
        )

    def wait_for_mapper(self) -> None:
        """Wait until the mapper offers its services, and knows this node.

        Raises:
            DeadlineExceededError: It does not in time.
        """
        if not self._save_mesh.wait_for_service(DISCOVERY_TIMEOUT_S):
            raise DeadlineExceededError(
                f"the mapper offered no save_mesh within {DISCOVERY_TIMEOUT_S:g} s"
            )
        self._wait("the mapper's metrics", lambda: bool(self._integration_s), DISCOVERY_TIMEOUT_S)

    def wait_for_subscribers(self) -> None:
        """Wait until the bridge knows of every subscription that this node knows of.

        A sample published earlier would not reach all of them.

        Raises:
            DeadlineExceededError: It does not in time.
        """
        self._wait("the bridge to know its subscribers", self._all_matched, DISCOVERY_TIMEOUT_S)

    def _all_matched(self) -> bool:
        return bool(self._matched) and all(
            count >= self._node.count_subscribers(topic) for topic, count in self._matched.items()
        )

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
        """Have the simulator look from ``pose`` and return what was published.

        Args:
            pose: Of the rig, or of ``sensor`` where one is named.
            sensor: Name of a sensor, or empty.
            map_frame: Frame of the pose.
            timeout_s: Until the service must have answered.

        Raises:
            RenderError: The bridge refused or failed; holds its message.
            DeadlineExceededError: No answer, or not all images, in time; or a second bridge of that
                name has come to be known, which would answer, too.
        """
        self._wait_for_others_to_leave()
        request = SetPose.Request(sensor=sensor, modalities=list(self._modalities))
        request.pose = pose_to_stamped_msg(pose, Header(frame_id=map_frame))
        started_s = time.monotonic()
        answer: SetPose.Response = self._call(self._set_pose, request, timeout_s)
        service_s = time.monotonic() - started_s
        if not answer.success:
            raise RenderError(f"set_pose refused: {answer.message}")
        key = _key(answer.stamp)
        self._wait(
            f"the images of sample {answer.sample_id}",
            lambda: len(self._images.get(key, ())) == len(self._modalities),
            ARRIVAL_TIMEOUT_S,
        )
        with self._changed:
            images = self._images.pop(key)
            # What came earlier belongs to samples that never got complete.
            self._images = {k: v for k, v in self._images.items() if k > key}
        stamp_ns = self._last_stamp_ns = nanoseconds(answer.stamp)
        return ReceivedView(images, answer.render_time, service_s, stamp_ns)

    def transfer_s(self, view: ReceivedView) -> float:
        """Return what the bridge waited for a view besides its rendering; 0: it did not tell."""
        with self._changed:
            return self._transfer_s.get(view.stamp_ns, 0.0)

    def wait_for_map(self, frames: int, timeout_s: float) -> list[float]:
        """Wait until the map holds ``frames`` frames; return what each took, in seconds.

        Frames that the mapper says are lost are not waited for: `shortfalls` tells of them. A time
        that was overtaken by the next frame's before it arrived is 0.

        Raises:
            DeadlineExceededError: It does not in time.
        """
        self._wait(
            f"{frames} frames in the map",
            lambda: (
                max(self._integration_s, default=0) >= frames
                or self._map.frames_integrated + self._map.samples_incomplete >= frames
            ),
            timeout_s,
        )
        return [self._integration_s.get(frame, 0.0) for frame in range(1, frames + 1)]

    def shortfalls(self, timeout_s: float) -> list[str]:
        """Wait for mapper and recorder to take the last view; return what they lack, if anything.

        Who has not taken it in time is among what is told.
        """
        end_s = time.monotonic() + timeout_s
        with self._changed:
            while (late := self._late()) and (left_s := end_s - time.monotonic()) > 0:
                self._changed.wait(left_s)
            told = [f"{name} had not taken all samples after {timeout_s:g} s" for name in late]
            for name, receipt in self._receipts.items():
                if lost := shortfall(state_of(receipt)):
                    told.append(f"{name}: {lost}")
                if receipt.ended and nanoseconds(receipt.header.stamp) < self._last_stamp_ns:
                    told.append(f"{name} had ended before the last sample")
            return told

    def _late(self) -> list[str]:
        """Return which readers of ours have not taken the last view."""
        return [
            name
            for name, receipt in self._receipts.items()
            if not receipt.ended and nanoseconds(receipt.header.stamp) < self._last_stamp_ns
        ]

    def sweep(self, poses: Sequence[Pose], map_frame: str, timeout_s: float) -> Sweep.Result:
        """Have the simulator look from many poses as fast as it goes; take no images.

        Raises:
            RenderError: A pose failed; holds its message.
            DeadlineExceededError: It has not ended in time; or there are two bridges of that name.
        """
        self._wait_for_others_to_leave()
        if not self._sweep.wait_for_server(DISCOVERY_TIMEOUT_S):
            raise DeadlineExceededError("the bridge offered no sweep in time")
        header = Header(frame_id=map_frame)
        stamped = [pose_to_stamped_msg(pose, header).pose for pose in poses]
        goal = Sweep.Goal(poses=PoseArray(header=header, poses=stamped))
        handle = _result(self._sweep.send_goal_async(goal), "sweep", DISCOVERY_TIMEOUT_S)
        result: Sweep.Result = _result(handle.get_result_async(), "sweep", timeout_s).result
        if not result.success:
            raise RenderError(f"sweep failed: {result.message}")
        return result

    def save_mesh(self, path: str, timeout_s: float) -> SaveMesh.Response:
        """Have the mapper write its mesh and return its answer.

        Raises:
            RenderError: It could not.
            DeadlineExceededError: No answer in time.
        """
        answer = self._call(self._save_mesh, SaveMesh.Request(path=path), timeout_s)
        if not answer.success:
            raise RenderError(f"save_mesh failed: {answer.message}")
        return answer

    def _call(self, client: Any, request: Any, timeout_s: float) -> Any:
        if not client.wait_for_service(DISCOVERY_TIMEOUT_S):
            raise DeadlineExceededError(
                f"{client.srv_name} was not offered within {DISCOVERY_TIMEOUT_S:g} s"
            )
        return _result(client.call_async(request), client.srv_name, timeout_s)

    def _wait(
        self,
        what: str,
        is_so: Callable[[], bool],
        timeout_s: float,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while not is_so():
                left_s = deadline - time.monotonic()
                if left_s <= 0:
                    raise DeadlineExceededError(f"waited {timeout_s:g} s for {what}")
                check()
                self._changed.wait(min(left_s, 0.5))

    def _topic(self, modality: str) -> str:
        return f"{self._namespace}/{TOPIC_BY_MODALITY.get(modality, modality)}/image_raw"

    def _take(self, modality: str) -> Callable[[Image], None]:
        def on_image(msg: Image) -> None:
            with self._changed:
                received = self._images.setdefault(_key(msg.header.stamp), {})
                received[modality] = image_from_msg(msg)
                self._changed.notify_all()

        return on_image

    def _on_ready(self, msg: Bool) -> None:
        with self._changed:
            self._bridge_is_ready = msg.data
            self._changed.notify_all()

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        said = {value.key: value.value for status in msg.status for value in status.values}
        matched = {k.removeprefix(SUBSCRIBERS): int(v) for k, v in said.items() if SUBSCRIBERS in k}
        with self._changed:
            self._matched.update(matched)
            if FIRST_BATCH_ERROR in said:
                self._first_batch_errors[said["address"]] = said[FIRST_BATCH_ERROR]
            if "last_transfer_s" in said:
                self._transfer_s[int(said["last_stamp_ns"])] = float(said["last_transfer_s"])
            self._changed.notify_all()

    def _on_map_status(self, msg: MapStatus) -> None:
        with self._changed:
            self._map = msg
            self._integration_s[msg.frames_integrated] = msg.integration_time
            self._changed.notify_all()

    def _on_receipt(self, msg: SampleReceipt) -> None:
        with self._changed:
            self._receipts[msg.node] = msg
            self._changed.notify_all()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return


def _result(future: Future, name: str, timeout_s: float) -> Any:
    """Return what a future comes to; `DeadlineExceededError` where it does not in time."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    if not done.wait(timeout_s):
        raise DeadlineExceededError(f"{name} did not answer within {timeout_s:g} s")
    return future.result()


def _key(stamp: Time) -> tuple[int, int]:
    return stamp.sec, stamp.nanosec
