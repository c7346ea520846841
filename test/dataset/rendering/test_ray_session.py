"""Connections to Ray: those that cannot be made are refused, and what is left behind is ended."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest
from waiting import PATIENCE_S, wait_until

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_dataset.rendering import session_guard
from oaisys_dataset.rendering.ray_session import ray_session
from oaisys_dataset.rendering.ray_settings import RaySettings, worker_count


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


@pytest.mark.parametrize("port", ["9" * 5000, "\u0661", "70000"])
def test_a_port_that_is_none_is_wrong_input(port: str) -> None:
    settings = RaySettings(address=f"127.0.0.1:{port}")
    with (
        pytest.raises(InvalidInputError, match="HOST:PORT of a Ray cluster"),
        ray_session(settings),
    ):
        pass


def test_a_worker_that_does_not_fit_is_wrong_input() -> None:
    with pytest.raises(InvalidInputError, match=r"memory_per_worker.*100000"):
        worker_count(RaySettings(memory_gb=100_000.0))


class SlowRay:
    """Does not start in time, but for the last try."""

    def __init__(self, slow_starts: int) -> None:
        self.slow_starts = slow_starts
        self.has_ended = False

    def init(self, **options: Any) -> None:
        logs = Path(options["_temp_dir"], "session_latest", "logs")
        logs.mkdir(parents=True)  # fails if something is left of the try before
        (logs / "raylet.out").write_text(f"Check failed: {self.slow_starts} starts are left")
        self.slow_starts -= 1
        if self.slow_starts >= 0:
            raise Exception("timed out during startup")  # noqa: TRY002 - as Ray does

    def shutdown(self) -> None:
        self.has_ended = True


def test_daemons_that_start_too_slowly_are_started_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setitem(sys.modules, "ray", SlowRay(2))
    with ray_session(RaySettings(workers=1, memory_gb=0.1)) as session:
        assert session.workers == 1
        assert session.ray.slow_starts == -1
    never = SlowRay(9)
    monkeypatch.setitem(sys.modules, "ray", never)
    expected = r"started: timed out.* \(4 starts are left in the logs (.*); load .* on \d+ cores\)"
    with (
        pytest.raises(OaisysError, match=expected) as raised,
        ray_session(RaySettings(workers=1, memory_gb=0.1)),
    ):
        pass
    found = re.search(expected, str(raised.value))
    assert found is not None
    assert Path(found[1], "raylet.out").is_file()
    assert never.slow_starts == 3
    assert never.has_ended


@pytest.mark.long
def test_workers_import_nothing_from_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("numpy", "random"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('planted')")
    monkeypatch.chdir(tmp_path)

    def path() -> list[str]:
        import random

        import numpy  # noqa: ICN001

        return [*sys.path, str(numpy.__file__), random.__file__, os.environ["PYTHONSAFEPATH"]]

    with ray_session(RaySettings(workers=1, memory_gb=0.2)) as session:
        found = session.ray.get(session.ray.remote(path).remote())
    assert not [each for each in found if each in ("", str(tmp_path))]
    assert not [each for each in found if each.startswith(str(tmp_path))]
    assert found[-1] == "1"
    assert "PYTHONSAFEPATH" not in os.environ


def test_the_guard_outlives_the_signals_that_end_its_driver(tmp_path: Path) -> None:
    folder = tmp_path / "ray"
    folder.mkdir()
    command = [sys.executable, "-I", "-S", session_guard.__file__, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as guard:
        status = Path(f"/proc/{guard.pid}/status")
        numbers = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
        # All of them: what started the tests may have had one ignored, as nohup does.
        wait_until(lambda: all(_ignores(status, number) for number in numbers), process=guard)
        for number in numbers:
            guard.send_signal(number)
        assert psutil.Process(guard.pid).is_running()
        assert guard.stdin is not None
        guard.stdin.close()  # as the death of the driver does
        assert guard.wait(PATIENCE_S) == 0
    assert not folder.exists()


def _ignores(status: Path, number: int) -> bool:
    (line,) = [x for x in status.read_text().splitlines() if x.startswith("SigIgn")]
    return bool(int(line.split()[1], 16) >> (number - 1) & 1)
