"""The node of a program that does something else in its main thread."""

from __future__ import annotations

import time
from typing import Any

import pytest
from rclpy.action import ActionClient, ActionServer, GoalResponse
from rclpy.task import Future
from waiting import PATIENCE_S

from oaisys_msgs.action import Sweep
from oaisys_ros_bridge.nodes.background_node import BackgroundNode, result_of

pytestmark = pytest.mark.ros


class SlowlyNoted:
    """A handle of an action's client, after whose requests another thread has time to answer."""

    def __init__(self, handle: Any) -> None:
        self._handle = handle

    def __getattr__(self, name: str) -> Any:
        return getattr(self._handle, name)

    def send_goal_request(self, request: Any) -> int:
        number: int = self._handle.send_goal_request(request)
        time.sleep(0.5)
        return number


@pytest.mark.usefixtures("ros_domain_id")
def test_an_answer_that_comes_at_once_is_not_lost() -> None:
    """rclpy notes only after it has sent a goal that it awaits an answer."""
    node = BackgroundNode("asks")
    with node:
        client = ActionClient(node.node, Sweep, "refuses")
        server = ActionServer(
            node.node,
            Sweep,
            "refuses",
            execute_callback=lambda _: Sweep.Result(),
            goal_callback=lambda _: GoalResponse.REJECT,
        )
        node.start()
        assert client.wait_for_server(PATIENCE_S)
        client._client_handle = SlowlyNoted(client._client_handle)
        sent: Future = node.send(lambda: client.send_goal_async(Sweep.Goal()), "goal", PATIENCE_S)
        assert not result_of(sent, "goal", PATIENCE_S).accepted
        server.destroy()
