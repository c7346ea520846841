"""Nodes without private parts of rclpy: they work, lose what is documented, and say so once."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from lifecycle_msgs.msg import State
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle.node import TransitionCallbackReturn
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger
from waiting import wait_until

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.nodes.managed_node import ManagedNode
from oaisys_ros_bridge.nodes.node_process import WaitingExecutor
from oaisys_ros_bridge.nodes.program_arguments import check_ros_arguments
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.private import (
    argument_errors,
    executor_threads,
    later_answers,
    lifecycle,
    parameters_at_start,
    waiting_messages,
)
from oaisys_ros_bridge.services import RequestQueue, close_queues

pytestmark = pytest.mark.ros

Lines = Callable[[], list[str]]


@pytest.fixture
def ros(ros_domain_id: int) -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.shutdown()


@pytest.mark.usefixtures("ros")
def test_without_its_threads_an_executor_still_ends(
    monkeypatch: pytest.MonkeyPatch, fallback_lines: Lines
) -> None:
    node, called = Node("ending"), threading.Event()
    executor = WaitingExecutor(num_threads=2)
    executor.add_node(node)
    node.create_timer(0.001, called.set)
    executor.spin_once(timeout_sec=5.0)
    assert called.wait(5.0)
    monkeypatch.setattr(executor_threads, "POOL", "gone")
    assert executor.wait_for_callbacks(5.0)
    executor.wait_for_callbacks(5.0)
    executor.shutdown()
    node.destroy_node()
    (line,) = fallback_lines()
    assert "rclpy's threads cannot be used (an executor has no gone)" in line


@pytest.mark.usefixtures("ros")
def test_without_rclpys_state_machine_a_node_knows_its_state(
    monkeypatch: pytest.MonkeyPatch, fallback_lines: Lines
) -> None:
    monkeypatch.setattr(lifecycle, "MACHINE", "gone")
    monkeypatch.setattr(lifecycle, "CHANGE_STATE", "gone_too")
    node = ManagedNode("managed")
    seen = [(node.state, node.state_name)]
    steps = (
        node.trigger_configure,
        node.trigger_activate,
        node.trigger_deactivate,
        node.trigger_cleanup,
    )
    for step in steps:
        assert step() == TransitionCallbackReturn.SUCCESS
        seen.append((node.state, node.state_name))
        assert node._state_machine.current_state[0] == node.state
    node.destroy_node()
    names = ["unconfigured", "inactive", "active", "inactive", "unconfigured"]
    assert [name for _, name in seen] == names
    assert seen[2][0] == State.PRIMARY_STATE_ACTIVE
    service, machine = fallback_lines()
    assert "rclpy's service change_state cannot be used (a node has no gone_too)" in service
    assert "rclpy's state machine cannot be used (a node has no gone)" in machine


@pytest.mark.usefixtures("ros")
def test_messages_that_cannot_be_taken_are_left_to_the_executor(
    monkeypatch: pytest.MonkeyPatch, fallback_lines: Lines
) -> None:
    node = Node("listening")
    heard: list[String] = []
    subscription = node.create_subscription(String, "chatter", heard.append, 10)
    publisher = node.create_publisher(String, "chatter", 10)
    wait_until(lambda: publisher.get_subscription_count() > 0)

    def taken() -> Any:
        with subscription.handle:
            return waiting_messages.take_waiting(subscription)

    publisher.publish(String(data="taken"))
    wait_until(lambda: (message := taken()) is not None and message[0].data == "taken")
    monkeypatch.setattr(waiting_messages, "TAKE", "gone")
    publisher.publish(String(data="left"))
    assert [taken(), taken()] == [None, None]
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin_once(timeout_sec=5.0)
    assert [message.data for message in heard] == ["left"]
    executor.shutdown()
    node.destroy_node()
    (line,) = fallback_lines()
    assert "Messages that wait cannot be used (a subscription's handle has no gone)" in line


@pytest.mark.usefixtures("ros")
def test_requests_wait_in_the_middleware_where_answers_cannot_be_sent_later(
    monkeypatch: pytest.MonkeyPatch, fallback_lines: Lines
) -> None:
    monkeypatch.setattr(later_answers, "SEND", "gone")
    node = Node("answering")
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = threading.current_thread().name
        return response

    queue = RequestQueue(node)
    queue.offer(Trigger, "ask", answer)
    client = node.create_client(Trigger, "ask")
    wait_until(client.service_is_ready)
    answers = [client.call_async(Trigger.Request()) for _ in range(3)]
    for each in answers:
        executor.spin_until_future_complete(each, timeout_sec=5.0)
    assert {each.result().message for each in answers} == {threading.current_thread().name}
    close_queues([queue])
    executor.shutdown()
    node.destroy_node()
    (line,) = fallback_lines()
    assert "rclpy's services cannot be used (a service has no gone)" in line


@pytest.mark.usefixtures("ros")
def test_a_request_that_fails_is_answered_and_the_next_one_served() -> None:
    node = Node("failing")
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    requests = itertools.count()

    def fail(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if next(requests) == 0:
            raise ZeroDivisionError("by nothing")
        response.success = True
        return response

    queue = RequestQueue(node)
    queue.offer(Trigger, "ask", fail)
    client = node.create_client(Trigger, "ask")
    wait_until(client.service_is_ready)
    first, second = client.call_async(Trigger.Request()), client.call_async(Trigger.Request())
    for answer in (first, second):
        executor.spin_until_future_complete(answer, timeout_sec=5.0)
    assert not first.result().success
    expected = "a fault of failing, see its log: ZeroDivisionError: by nothing"
    assert first.result().message == expected
    assert second.result().success
    close_queues([queue])
    executor.shutdown()
    node.destroy_node()


def test_without_rclpys_errors_wrong_arguments_are_still_refused(
    ros_domain_id: int, monkeypatch: pytest.MonkeyPatch, fallback_lines: Lines
) -> None:
    wrong = ["--ros-args", "-r", "not a rule"]
    monkeypatch.setattr(argument_errors, "NAMES", ("GoneError", "UnknownROSArgsError"))
    for _ in range(2):
        with pytest.raises(InvalidInputError, match=r"arguments.*not a rule"):  # noqa: SIM117
            with check_ros_arguments(wrong):
                rclpy.init(args=["node", *wrong])
    (line,) = fallback_lines()
    assert "rclpy's errors cannot be used" in line


def test_without_what_a_node_was_started_with_it_starts(
    ros_domain_id: int, monkeypatch: pytest.MonkeyPatch, fallback_lines: Lines
) -> None:
    monkeypatch.setattr(parameters_at_start, "OVERRIDES", "gone")
    rclpy.init(args=["node", "--ros-args", "-p", "voxelsize:=0.3"])
    node = ParameterNode("node")
    for _ in range(2):
        assert parameters_at_start.parameters_at_start(node) == ()
    node.destroy_node()
    rclpy.shutdown()
    (line,) = fallback_lines()
    assert "rclpy's parameters cannot be used (a node has no gone)" in line
