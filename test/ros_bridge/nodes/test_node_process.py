"""The end of a node's process: nothing that was begun is left to stumble over what is gone."""

from __future__ import annotations

import gc
import threading
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from oaisys_ros_bridge.nodes.node_process import WaitingExecutor

pytestmark = pytest.mark.ros


@pytest.fixture
def context(ros_domain_id: int) -> Iterator[Context]:
    context = Context()
    rclpy.init(context=context)
    yield context
    rclpy.shutdown(context=context)


def test_a_callback_that_has_no_thread_yet_is_dropped_in_silence(
    context: Context, capfd: pytest.CaptureFixture[str], recwarn: pytest.WarningsRecorder
) -> None:
    node = Node("ending", context=context)
    executor = WaitingExecutor(num_threads=1, context=context)
    executor.add_node(node)
    called = threading.Event()
    node.create_timer(0.001, called.set)
    release = threading.Event()
    executor._executor.submit(release.wait)  # the only thread is busy
    executor.spin_once(timeout_sec=5.0)  # hands the timer's callback to it

    assert not executor.wait_for_callbacks(0.1)
    threading.Timer(0.2, release.set).start()
    assert executor.wait_for_callbacks(30.0)
    executor.shutdown()
    node.destroy_node()
    del executor
    gc.collect()

    assert not called.is_set()
    assert "never retrieved" not in capfd.readouterr().err
    assert [str(each.message) for each in recwarn if "never awaited" in str(each.message)] == []
