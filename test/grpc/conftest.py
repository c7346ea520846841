"""A real server for each test that asks for one, or one for a module."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from leak_check import LeakCheck
from served_simulator import FLAT_WORLD, Server, stepped_server

from oaisys_grpc.client.simulator_client import SimulatorClient


@pytest.fixture
def start_server(tmp_path: Path, leaks: LeakCheck) -> Iterator[Callable[..., Server]]:
    """Start a server: ``start_server(config, *options, **environment)``."""
    with ExitStack() as stack:

        def start(config: dict[str, Any], *options: str, **env: str) -> Server:
            number = len(list(tmp_path.iterdir()))
            return stack.enter_context(
                Server(tmp_path / f"server{number}", config, *options, **env)
            )

        yield start


@pytest.fixture(scope="module")
def flat_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server with the plane, shared by the tests of a module."""
    with Server(tmp_path_factory.mktemp("grpc") / "flat", FLAT_WORLD) as server:
        yield server


@pytest.fixture(scope="module")
def stepped_flat_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """As that, with a first batch."""
    with stepped_server(tmp_path_factory.mktemp("stepped") / "flat", FLAT_WORLD) as server:
        yield server


@pytest.fixture(scope="module")
def flat_client(flat_server: Server) -> Iterator[SimulatorClient]:
    """A client of that server; a first batch stands."""
    with flat_server.client() as client:
        client.step_batch()
        yield client
