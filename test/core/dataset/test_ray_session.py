"""Connections to Ray that cannot be made are refused before any world is begun."""

from __future__ import annotations

import socket

import pytest

from oaisys_core.dataset.ray_session import RaySettings, embedded_workers, ray_session
from oaisys_core.errors import InvalidInputError


@pytest.mark.parametrize("host", ["127.0.0.1", "no-such-machine.invalid"])
def test_an_address_without_a_cluster_is_wrong_input(host: str) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = RaySettings(address=f"{host}:{port}")
    with (
        pytest.raises(InvalidInputError, match=rf"address.*{host}.*HOST:PORT of a Ray cluster"),
        ray_session(settings),
    ):
        pass


def test_a_worker_that_does_not_fit_is_wrong_input() -> None:
    with pytest.raises(InvalidInputError, match=r"memory_per_worker.*100000"):
        embedded_workers(RaySettings(memory_gb=100_000.0))
