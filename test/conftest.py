"""Fixtures for every test: a ROS domain of its own, and a check that no process is left behind."""

from __future__ import annotations

import fcntl
import os
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

LARGEST_DOMAIN_ID = 101
"""Above it, DDS's ports run into those that Linux gives to clients."""

MARK = "OAISYS_TEST_PROCESS"
"""Variable that marks the processes of a test."""


@pytest.fixture
def ros_domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A `ROS_DOMAIN_ID` that no other test of this machine uses; set for child processes too.

    A file lock claims it, so it holds across pytest processes and goes with a killed one.
    """
    folder = Path(tempfile.gettempdir(), f"oaisys-ros-domains-{os.getuid()}")
    folder.mkdir(exist_ok=True)
    for domain_id in range(1, LARGEST_DOMAIN_ID + 1):
        with (folder / str(domain_id)).open("w") as claim:
            try:
                fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
            yield domain_id
            return
    pytest.fail(f"all {LARGEST_DOMAIN_ID} ROS domains are in use")


@pytest.fixture
def no_process_left(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fail a test that leaves processes running, and end them.

    They are known by a mark in their environment, so orphans are found too.
    """
    mark = str(uuid.uuid4())
    monkeypatch.setenv(MARK, mark)
    yield
    _, left = psutil.wait_procs(_marked(mark), timeout=5.0)
    commands = [_command(process) for process in left]
    for process in left:
        process.kill()
    assert not commands, f"processes left behind: {commands}"


def _marked(mark: str) -> list[psutil.Process]:
    return [p for p in psutil.process_iter() if _mark_of(p) == mark and p.pid != os.getpid()]


def _mark_of(process: psutil.Process) -> str | None:
    try:
        return process.environ().get(MARK)
    except psutil.Error:
        return None


def _command(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return str(process)
