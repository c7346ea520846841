"""The programs that ``ros2 run`` starts: what a signal does is settled before ROS is loaded."""

from __future__ import annotations

import sys
from importlib import import_module

from oaisys_core.errors import ShortageError
from oaisys_core.system.ending.owner import follow_owner
from oaisys_core.system.ending.signals import exit_at_signals
from oaisys_core.system.standard_streams import open_standard_streams


def bridge() -> int:
    """Run the node ``oaisys_bridge`` until it is told to end."""
    return _run("bridge")


def mapper() -> int:
    """Run the node ``oaisys_mapper`` until it is told to end."""
    return _run("mapper")


def player() -> int:
    """Run the node ``oaisys_player`` until its bag ends or it is told to end."""
    return _run("player")


def recorder() -> int:
    """Run the node ``oaisys_recorder`` until it is told to end."""
    return _run("recorder")


def _run(name: str) -> int:
    exit_at_signals()
    follow_owner()
    open_standard_streams()
    try:
        module = import_module(f"oaisys_ros_bridge.nodes.{name}")
    except ShortageError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return int(module.main())
