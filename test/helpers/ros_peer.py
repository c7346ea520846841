"""A node's process, and a user beside it who subscribes, calls and waits."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import ListParameters
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.task import Future
from served_simulator import Server
from std_msgs.msg import Bool, Header
from waiting import PATIENCE_S, START_PATIENCE_S, wait_until

from oaisys_core.types import Pose
from oaisys_msgs.srv import SetPose
from oaisys_ros_bridge.bags.info import repeats_of
from oaisys_ros_bridge.bags.mcap_format.finished_bag import open_finished
from oaisys_ros_bridge.bridge.status import SUBSCRIBERS
from oaisys_ros_bridge.conversions import pose_to_stamped_msg
from oaisys_ros_bridge.experiments.status import DIAGNOSTICS_DEPTH
from oaisys_ros_bridge.qos import LATCHED_QOS

SAMPLE_TYPES = {
    "/camera/color/image_raw": "sensor_msgs/msg/Image",
    "/camera/color/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/depth/image_raw": "sensor_msgs/msg/Image",
    "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/depth_registered/points": "sensor_msgs/msg/PointCloud2",
    "/camera/semantic_0/image_raw": "sensor_msgs/msg/Image",
    "/camera/instance/image_raw": "sensor_msgs/msg/Image",
    "/ground_truth/odometry": "nav_msgs/msg/Odometry",
    "/oaisys_bridge/sample_info": "oaisys_msgs/msg/SampleInfo",
    "/tf": "tf2_msgs/msg/TFMessage",
}
LATCHED_TYPES = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/camera/semantic_0/labels": "oaisys_msgs/msg/SemanticLabels",
}
"""What the bridge publishes of each sample of the default camera, and what it latches."""
ASK_AGAIN_S = 1.0
"""After a question whose answer may have been dropped."""


class NodeProcess:
    """A node of ours in a process of its own; what it says goes to a file."""

    def __init__(self, module: str, log: Path, *arguments: str) -> None:
        self.log = log
        with log.open("w") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", f"oaisys_ros_bridge.nodes.{module}", *arguments],
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """End it as Ctrl-C does; return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
            self.process.wait()


class User:
    """A node in this process that keeps all messages it gets, by topic."""

    def __init__(self, namespace: str = "") -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = Node("user", context=self._context, namespace=namespace)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}
        self._subscriptions: list[Subscription] = []
        self.received: dict[str, list[Any]] = {}
        self._matched: dict[str, int] = {}
        self.listen(Bool, "oaisys_bridge/ready", LATCHED_QOS)
        self._diagnostics = self.node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, DIAGNOSTICS_DEPTH
        )

    def listen(self, kind: type[Any], topic: str, qos: QoSProfile) -> None:
        self.received[topic] = []
        subscription = self.node.create_subscription(kind, topic, self.received[topic].append, qos)
        self._subscriptions.append(subscription)

    def spin_with(self, node: Node) -> None:
        """Receive the messages of another node of this context, too."""
        self._executor.add_node(node)

    def wait_until(
        self,
        condition: Callable[[], Any],
        patience_s: float = PATIENCE_S,
        explain: Callable[[], object] = lambda: "",
    ) -> Any:
        """Take messages in until the condition holds, and return what it returned."""
        pause = partial(self._executor.spin_once, timeout_sec=0.05)
        return wait_until(condition, patience_s, explain=explain, pause=pause)

    def wait_until_ready(self, ready: bool = True) -> None:
        """Wait for the bridge to be (or not to be) ready, and to be heard on all topics."""
        states = self.received["oaisys_bridge/ready"]
        self.wait_until(lambda: states and states[-1].data is ready, START_PATIENCE_S)
        self.wait_until(lambda: all(s.get_publisher_count() for s in self._subscriptions))
        if ready:
            self.wait_until(lambda: self._matched)
            own = {s.topic_name for s in self._subscriptions} & self._matched.keys()
            self.wait_until_matched(own)

    def wait_until_matched(self, topics: Iterable[str], subscribers: int = 1) -> None:
        """Wait until the bridge says that its topics have this many subscribers.

        A subscriber that knows its publisher may still be unknown to it, and then misses what is
        published.
        """
        missing = set(topics)
        self.wait_until(lambda: all(self._matched.get(t, 0) >= subscribers for t in missing))

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for value in (v for s in msg.status for v in s.values if v.key.startswith(SUBSCRIBERS)):
            self._matched[value.key.removeprefix(SUBSCRIBERS)] = int(value.value)

    def call(self, kind: type[Any], name: str, request: Any) -> Any:
        return self.answer(self.begin(kind, name, request))

    def begin(self, kind: type[Any], name: str, request: Any) -> Future:
        """Call a service of the bridge without waiting for its answer."""
        if name not in self._clients:
            self._clients[name] = self.client(kind, f"oaisys_bridge/{name}")
        return self._clients[name].call_async(request)

    def client(self, kind: type[Any], name: str) -> Any:
        """Return a client of a service that any node of ours offers, and whose node knows it."""
        client = self.node.create_client(kind, name)
        self.wait_until(client.service_is_ready)
        wait_until_known(self.node, name.rpartition("/")[0], self.wait_until)
        return client

    def action_client(self, kind: type[Any], name: str) -> ActionClient:
        """Return a client of an action that any node of ours offers, and whose node knows it."""
        client = ActionClient(self.node, kind, name)
        self.wait_until(client.server_is_ready)
        wait_until_known(self.node, name.rpartition("/")[0], self.wait_until)
        return client

    def answer(self, future: Future) -> Any:
        return self.wait_until(lambda: future.result() if future.done() else None)

    def set_pose(self, pose: Pose, **fields: Any) -> SetPose.Response:
        return self.call(SetPose, "set_pose", SetPose.Request(pose=stamped(pose), **fields))

    def close(self) -> None:
        self.node.destroy_node()
        self._executor.shutdown()
        rclpy.shutdown(context=self._context)


def wait_until_known(
    node: Node, server: str, wait_until: Callable[[Callable[[], Any]], Any]
) -> None:
    """Wait until answers of another node reach the clients that ours has made until now.

    A service is ready once its client knows it. The server may still not know the client, and after
    0.1 s drops its answer. It hears of our clients in the order they were made: once it has
    answered one that is made now, it knows those before it.
    """
    probe = node.create_client(ListParameters, f"{server}/list_parameters")
    wait_until(probe.service_is_ready)
    answers: list[Future] = []
    asked_s = 0.0

    def is_answered() -> bool:
        nonlocal asked_s
        if time.monotonic() > asked_s + ASK_AGAIN_S:
            answers.append(probe.call_async(ListParameters.Request()))
            asked_s = time.monotonic()
        return any(answer.done() for answer in answers)

    wait_until(is_answered)
    node.destroy_client(probe)


def stamped(pose: Pose, frame: str = "map") -> PoseStamped:
    return pose_to_stamped_msg(pose, Header(frame_id=frame))


def nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def messages_of_samples(bag: Path) -> dict[str, int]:
    """Return how many messages of each topic a bag holds, without transforms that are repeated."""
    with open_finished(next(bag.glob("*.mcap"))) as (reader, summary):
        assert summary.statistics is not None
        repeats = repeats_of(reader, summary)
    counts = summary.statistics.channel_message_counts
    return {
        channel.topic: counts.get(channel.id, 0) - repeats.get(channel.topic, 0)
        for channel in summary.channels.values()
    }


class Stage:
    """A folder with servers, nodes and one user that go when the ``with`` block is left."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._stack = ExitStack()
        self.user = User()
        self._stack.callback(self.user.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def start_world(self, config: dict[str, Any], *options: str, **env: str) -> Server:
        """Start a server for a world, on a free port unless options say otherwise."""
        number = len(list(self._folder.iterdir()))
        folder = self._folder / f"server{number}"
        return self._stack.enter_context(Server(folder, config, *options, **env))

    def start_node(self, module: str, *arguments: str) -> NodeProcess:
        node = NodeProcess(module, self._folder / f"{module}.log", *arguments)
        self._stack.callback(node.end)
        return node

    def start_bridge(self, address: str) -> NodeProcess:
        return self.start_node("bridge", "--ros-args", "-p", f"address:={address}")
