"""Starts a real server in another process, on a free port, with a small world."""

from __future__ import annotations

import contextlib
import copy
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import grpc
import psutil
import yaml
from waiting import PATIENCE_S, START_PATIENCE_S, wait_until

from oaisys_core.errors import OaisysError
from oaisys_grpc.client.simulator_client import SimulatorClient

FLAT_WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"preset": "plane", "extent_m": 40, "resolution_px": 33},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64, "relief": 0}},
    "assets": {"rocks": []},
    "sensors": {"cameras": [{"width_px": 64, "height_px": 48, "fx_px": 54.114, "fy_px": 54.114}]},
}
"""The plane z = 0, whose depth images are known in closed form."""

ROCKY_WORLD: dict[str, Any] = {
    **FLAT_WORLD,
    "stage": {"surroundings": "plain", "extent_m": 24, "resolution_px": 65},
    "assets": {"rocks": [{"count": [20, 40]}]},
}

MOUNDS: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 32, "resolution_px": 129},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64}},
    "assets": {"rocks": [{"count": [20, 20]}]},
}
"""A world whose survey closes with two views of 160x120, but not of 96x72.

Seen from 10 m, a pixel of 96x72 covers 12 cm, more than a voxel: the borders of classes are too
blurred for their IoU.
"""


class Server:
    """A running server process, a context manager; what it says goes to files in a new folder."""

    def __init__(self, folder: Path, config: dict[str, Any], *options: str, **env: str) -> None:
        folder.mkdir()
        self.stdout, self.stderr = folder / "stdout", folder / "stderr"
        file = folder / "world.yaml"
        file.write_text(yaml.safe_dump(copy.deepcopy(config)))
        command = [sys.executable, "-m", "oaisys_grpc", "serve", "--config", str(file)]
        command += ["--address", "127.0.0.1:0", *options]
        with self.stdout.open("w") as out, self.stderr.open("w") as err:
            own = {"TMPDIR": str(folder), "XDG_STATE_HOME": str(folder / "state")}
            self.process = subprocess.Popen(
                command, stdout=out, stderr=err, env={**os.environ, **own, **env}
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    @property
    def address(self) -> str:
        line: str = wait_until(
            lambda: "\n" in (said := self.stdout.read_text()) and said,
            START_PATIENCE_S,
            process=self.process,
            explain=self.stderr.read_text,
        )
        assert line.startswith("ready: "), line
        return line.removeprefix("ready: ").strip()

    def client(self) -> SimulatorClient:
        return SimulatorClient(self.address, timeout_s=PATIENCE_S)

    def worker(self) -> psutil.Process:
        """The worker's process, once there is one."""
        assert self.process.poll() is None, self.stderr.read_text()
        server = psutil.Process(self.process.pid)
        worker: psutil.Process = wait_until(
            lambda: next(filter(_is_worker, server.children()), None)
        )
        return worker

    def end(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
            self.process.wait()


def free_address() -> str:
    """Return an address that nobody serves at yet."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{free.getsockname()[1]}"


def code_of(error: OaisysError) -> grpc.StatusCode:
    """The status that the failed call had."""
    call: Any = error.__cause__
    code: grpc.StatusCode = call.code()
    return code


def _is_worker(process: psutil.Process) -> bool:
    try:
        return "oaisys_grpc.worker" in process.cmdline()
    except psutil.Error:  # it ended meanwhile
        return False


@contextlib.contextmanager
def stepped_server(folder: Path, config: dict[str, Any]) -> Iterator[Server]:
    """Run a server that has made its first batch."""
    with Server(folder, config) as server:
        with server.client() as client:
            client.step_batch(seed=3)
        yield server
