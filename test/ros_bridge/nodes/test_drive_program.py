"""The program of one drive: how it ends at a signal."""

from __future__ import annotations

import signal

import pytest
from ros_peer import Stage

from oaisys_ros_bridge.nodes.drive import READY

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)]
)
def test_a_signal_ends_the_drive_program_with_its_code(
    stage: Stage, number: signal.Signals
) -> None:
    program = stage.start_node("drive")
    # The user listens to it, too.
    stage.user.wait_until(lambda: stage.user.node.count_subscribers(READY) == 2)
    assert program.end(number) == 128 + number
