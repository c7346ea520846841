"""The simulator behind the live page: one that is started for it, or one that runs already."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from oaisys_core.system.ending.signals import defer_signals
from oaisys_core.system.processes import ManagedProcess
from oaisys_core.system.python_programs import python_command
from oaisys_grpc.client.simulator_client import ClientTls, SimulatorClient
from oaisys_ros_bridge.experiments.bringup import (
    START_TIMEOUT_S,
    naming_logs,
    serve_arguments,
    socket_folder,
)
from oaisys_ros_bridge.experiments.configuration import ExperimentOptions, write_config

CONNECT_TIMEOUT_S = 20.0
"""How long a running simulator may take to answer."""


@dataclass(frozen=True)
class LiveSimulator:
    """A simulator that serves.

    Attributes:
        client: Its client.
        check: Raises `WorkerLostError` where the simulator was started here and has ended.
    """

    client: SimulatorClient
    check: Callable[[], None]


@contextmanager
def start_simulator(options: ExperimentOptions) -> Iterator[LiveSimulator]:
    """Start a simulator in a process of its own, and end it after the block.

    Raises:
        ConfigError: The configuration cannot be used.
        OaisysError: The process ended, or does not serve in time; quotes its log.
    """
    config_path = write_config(options)
    with ExitStack() as stack:
        stack.enter_context(naming_logs(options.out / "logs"))
        address = f"unix:{stack.enter_context(socket_folder()).path}/server"
        command = python_command("oaisys_grpc", *serve_arguments(options, config_path, address))
        log = options.out / "logs" / "server.log"
        with defer_signals():
            server = ManagedProcess("server", command, log, dict(os.environ))
            stack.enter_context(server)
        server.wait_for_line("ready:", START_TIMEOUT_S)
        client = stack.enter_context(SimulatorClient(address, timeout_s=START_TIMEOUT_S))
        yield LiveSimulator(client, server.check)


@contextmanager
def connect_simulator(address: str, tls: ClientTls | None) -> Iterator[LiveSimulator]:
    """Connect to a simulator that runs already, and leave it running.

    Raises:
        OaisysError: It cannot be reached.
    """
    with SimulatorClient(address, timeout_s=START_TIMEOUT_S, tls=tls) as client:
        client.wait_ready(CONNECT_TIMEOUT_S)
        yield LiveSimulator(client, _nothing)


def _nothing() -> None:
    """Check nothing: the simulator is somebody else's."""
