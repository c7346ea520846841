"""The check for leaks itself: what is left is found, and what another test has is not blamed."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from leak_check import MARK, LeakCheck
from waiting import wait_until

OWNER = """
import fcntl, mmap, sys, time
lock = open(sys.argv[1] + "_el", "w")
fcntl.flock(lock, fcntl.LOCK_EX)
with open(sys.argv[1], "w+b") as file:
    file.truncate(4096)
    memory = mmap.mmap(file.fileno(), 4096)
print("ready", flush=True)
time.sleep(100)
"""
USER = """
import mmap, sys, time
with open(sys.argv[1], "r+b") as file:
    memory = mmap.mmap(file.fileno(), 4096)
print("ready", flush=True)
time.sleep(100)
"""
LISTENER = """
import socket, subprocess, sys, time
listener = socket.create_server(("127.0.0.1", int(sys.argv[1])))
if "heir" in sys.argv:
    sleep = [sys.executable, "-c", "import time; time.sleep(100)"]
    heir = subprocess.Popen(sleep, env={}, pass_fds=[listener.fileno()], stdout=2)
print("ready", flush=True)
time.sleep(100)
"""
NODE = """
import rclpy, time
rclpy.init()
node = rclpy.create_node("killed")
print("ready", flush=True)
time.sleep(100)
"""


def look(check: LeakCheck) -> None:
    """Wait until the check has looked at all that runs now."""
    looks = check.looks
    wait_until(lambda: check.looks >= looks + 2)  # it may be looking just now


class Processes:
    """Python programs in an environment of their own."""

    def __init__(self) -> None:
        self.mark = str(uuid.uuid4())
        self.started: list[subprocess.Popen[str]] = []

    def start(
        self, code: str, *arguments: str, mark: str | None, domain: str
    ) -> subprocess.Popen[str]:
        env = {k: v for k, v in os.environ.items() if k != MARK} | {"ROS_DOMAIN_ID": domain}
        process = subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=env if mark is None else env | {MARK: mark},
        )
        self.started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        return process

    def kill(self) -> None:
        for process in self.started:
            process.kill()
            process.wait()
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.close()
            process.stdout.close()


@pytest.fixture
def processes() -> Iterator[Processes]:
    processes = Processes()
    yield processes
    processes.kill()


@pytest.fixture
def segment() -> Iterator[str]:
    """The name of a segment as Fast DDS gives one to each of its participants."""
    name = f"/dev/shm/fastrtps_{uuid.uuid4().hex[:16]}"
    yield name
    for file in (name, f"{name}_el"):
        Path(file).unlink(missing_ok=True)


@pytest.fixture
def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def test_memory_of_a_killed_process_is_left_behind(processes: Processes, segment: str) -> None:
    with LeakCheck(processes.mark) as check:
        processes.start(OWNER, segment, mark=processes.mark, domain="1")
        look(check)
        processes.kill()

    assert check.left_behind() == [f"shared memory: {segment}"]


@pytest.mark.parametrize("mark", [None, "another test's"])
@pytest.mark.parametrize("owner_ends", [True, False])
def test_memory_of_another_domain_is_not(
    processes: Processes, segment: str, mark: str | None, owner_ends: bool
) -> None:
    owner = processes.start(OWNER, segment, mark=mark, domain="2")
    with LeakCheck(processes.mark) as check:
        user = processes.start(USER, segment, mark=processes.mark, domain="1")
        look(check)
        user.kill()
        if owner_ends:
            owner.kill()
            owner.wait()

    assert Path(segment).exists()
    assert check.left_behind() == []


def test_memory_of_an_unmarked_process_in_the_domain_is_left_behind(
    processes: Processes, segment: str
) -> None:
    owner = processes.start(OWNER, segment, mark=None, domain="1")
    with LeakCheck(processes.mark) as check:
        user = processes.start(USER, segment, mark=processes.mark, domain="1")
        look(check)
        user.kill()

    (left,) = check.left_behind()
    assert left.startswith(f"shared memory: {segment}, used by ['{owner.pid} ")


def test_memory_that_nobody_owns_is_left_behind(processes: Processes, segment: str) -> None:
    processes.start(OWNER, segment, mark=None, domain="2")
    processes.kill()
    with LeakCheck(processes.mark) as check:
        user = processes.start(USER, segment, mark=processes.mark, domain="1")
        look(check)
        user.kill()

    assert check.left_behind() == [f"shared memory: {segment}"]


def test_a_port_that_another_process_has_taken_since_is_not(
    processes: Processes, free_port: int
) -> None:
    with LeakCheck(processes.mark) as check:
        first = processes.start(LISTENER, str(free_port), mark=processes.mark, domain="1")
        look(check)
        first.kill()
        first.wait()
        processes.start(LISTENER, str(free_port), mark=None, domain="1")

    assert check.left_behind() == []


@pytest.mark.long
def test_a_port_that_an_unmarked_heir_has_open_is_left_behind(
    processes: Processes, free_port: int
) -> None:
    with LeakCheck(processes.mark) as check:
        first = processes.start(LISTENER, str(free_port), "heir", mark=processes.mark, domain="1")
        look(check)
        (heir,) = psutil.Process(first.pid).children()
        first.kill()
        first.wait()

    try:
        (left,) = check.left_behind()
        assert left.startswith(f"port: {free_port}, held by ['{heir.pid} ")
    finally:
        heir.kill()


@pytest.mark.long
def test_a_process_that_drops_its_mark_is_left_behind(processes: Processes) -> None:
    drops = (
        "import os, sys; sys.stdin.readline(); "
        "os.execve(sys.executable, [sys.executable, '-c', 'import time; time.sleep(100)'], {})"
    )
    with LeakCheck(processes.mark) as check:
        process = processes.start(
            f"print('ready', flush=True); {drops}", mark=processes.mark, domain="1"
        )
        look(check)
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.close()
        wait_until(lambda: MARK not in psutil.Process(process.pid).environ())

    (left,) = check.left_behind()
    assert left.startswith("process: ")
    assert process.wait(10) != 0


@pytest.mark.ros
def test_memory_of_a_killed_node_is_left_behind(processes: Processes, ros_domain_id: int) -> None:
    with LeakCheck(processes.mark) as check:
        processes.start(NODE, mark=processes.mark, domain=str(ros_domain_id))
        look(check)
        processes.kill()

    (left,) = check.left_behind()
    segment = left.removeprefix("shared memory: ")
    assert segment.startswith("/dev/shm/fastrtps_")
    for file in (segment, f"{segment}_el"):
        Path(file).unlink()
