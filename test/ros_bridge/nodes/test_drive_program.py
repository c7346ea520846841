"""The program of one drive: how it ends at a signal."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from ros_peer import Stage
from waiting import PATIENCE_S

from oaisys_ros_bridge.nodes.drive import READY

pytestmark = pytest.mark.ros

INTERRUPTED_WHILE_MADE = """
import os, runpy, signal, sys
from oaisys_ros_bridge.nodes.background_node import BackgroundNode

start = BackgroundNode.start

def start_and_interrupt(client):
    start(client)
    os.kill(os.getpid(), signal.SIGTERM)

BackgroundNode.start = start_and_interrupt
sys.argv = ["drive"]
runpy.run_module("oaisys_ros_bridge.nodes.drive", run_name="__main__")
"""


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)]
)
def test_a_signal_ends_the_drive_program_with_its_code(
    stage: Stage, number: signal.Signals
) -> None:
    program = stage.start_node("drive")
    # The user listens to it, too.
    stage.user.wait_until(lambda: stage.user.node.count_subscribers(READY) == 2)
    assert program.end(number) == 128 + number, program.log.read_text()


@pytest.mark.usefixtures("stage")
def test_a_signal_ends_the_drive_program_while_its_client_is_made() -> None:
    program = [sys.executable, "-c", INTERRUPTED_WHILE_MADE]
    done = subprocess.run(program, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 128 + signal.SIGTERM, done.stderr
    assert done.stderr == "drive: interrupted before it began\n"
