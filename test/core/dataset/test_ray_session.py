"""Connections to Ray: those that cannot be made are refused, and what is left behind is ended."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from waiting import PATIENCE_S, wait_until

from oaisys_core.dataset import session_guard
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


def test_the_guard_outlives_the_signals_that_end_its_driver(tmp_path: Path) -> None:
    folder = tmp_path / "ray"
    folder.mkdir()
    command = [sys.executable, "-I", "-S", session_guard.__file__, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as guard:
        status = Path(f"/proc/{guard.pid}/status")
        wait_until(lambda: _ignores(status, signal.SIGHUP), process=guard)
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            guard.send_signal(number)
        assert psutil.Process(guard.pid).is_running()
        assert guard.stdin is not None
        guard.stdin.close()  # as the death of the driver does
        assert guard.wait(PATIENCE_S) == 0
    assert not folder.exists()


def _ignores(status: Path, number: int) -> bool:
    (line,) = [x for x in status.read_text().splitlines() if x.startswith("SigIgn")]
    return bool(int(line.split()[1], 16) >> (number - 1) & 1)
