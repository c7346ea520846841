"""What a killed program has started ends with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from waiting import PATIENCE_S, wait_until

from oaisys_core.system.ending import owner as owner_module
from oaisys_core.system.ending.owner import VARIABLE, end_with, owner_variables

CHILD = """
import os, signal, sys, time
from oaisys_core.system.ending.owner import follow_owner
follow_owner()
assert "OAISYS_OWNER" not in os.environ
def told(number, _):
    open(sys.argv[1], "a").write("told")
    sys.exit(0)
signal.signal(signal.SIGTERM, told)
print(os.getpid(), flush=True)
time.sleep(100)
"""
OWNER = """
import os, subprocess, sys, time
from oaisys_core.system.ending.owner import command_with_owner, owner_variables
kind, *command = sys.argv[1:]
if kind == "foreign":
    process = subprocess.Popen(command_with_owner(command))
    print(process.pid, flush=True)
else:
    subprocess.Popen(command, env=os.environ | owner_variables(), shell=False)
time.sleep(100)
"""


def start(*command: str) -> tuple[subprocess.Popen[str], psutil.Process]:
    """Start an owner; return it and the process that it has started."""
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, *command], stdout=subprocess.PIPE, text=True
    )
    assert owner.stdout is not None
    return owner, psutil.Process(int(owner.stdout.readline()))


def has_ended(process: psutil.Process) -> bool:
    return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("shell", [(), ("sh", "-c", '"$@"; true', "sh")], ids=["own", "behind sh"])
def test_a_program_is_told_of_its_owners_end(
    tmp_path: Path, number: signal.Signals, shell: tuple[str, ...]
) -> None:
    told = tmp_path / "told"
    owner, child = start("own", *shell, sys.executable, "-c", CHILD, str(told))
    owner.send_signal(number)
    owner.wait(PATIENCE_S)
    wait_until(lambda: has_ended(child))
    assert told.read_text() == "told"


def test_a_program_of_others_ends_with_its_owner() -> None:
    owner, child = start("foreign", "sleep", "100")
    wait_until(lambda: child.name() == "sleep")
    owner.kill()
    owner.wait(PATIENCE_S)
    wait_until(lambda: has_ended(child))


def test_a_program_of_others_that_is_not_there_is_told_by_name() -> None:
    done = subprocess.run(
        owner_module.command_with_owner(["no-such-program"]),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (127, "no-such-program: No such file or directory\n")


def test_a_program_whose_owner_is_gone_before_it_begins_ends(tmp_path: Path) -> None:
    gone = subprocess.Popen(["true"])
    gone.wait(PATIENCE_S)
    environment = {**os.environ, VARIABLE: f"{gone.pid} {int(signal.SIGTERM)}"}
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(tmp_path / "told")],
        env=environment,
        timeout=PATIENCE_S,
        check=False,
        capture_output=True,
    )
    assert done.returncode in (0, -signal.SIGTERM)


def test_without_pidfd_the_owner_is_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(_: int) -> int:
        raise PermissionError

    monkeypatch.setattr(os, "pidfd_open", forbidden)
    monkeypatch.setattr(owner_module, "LOOK_S", 0.01)
    sent: list[tuple[int, int]] = []
    monkeypatch.setattr(owner_module, "_ask_kernel", lambda _: None)
    monkeypatch.setattr(owner_module, "END_S", 1000.0)
    monkeypatch.setattr(os, "kill", kill_noting(sent, os.kill))
    with subprocess.Popen(["sleep", "100"]) as other:
        end_with(other.pid, signal.SIGTERM)
        other.kill()
    wait_until(lambda: sent)
    assert sent == [(os.getpid(), signal.SIGTERM)]


def kill_noting(sent: list[tuple[int, int]], kill: object) -> object:
    def note(process: int, number: int) -> None:
        if process == os.getpid():
            sent.append((process, number))
        else:
            kill(process, number)  # type: ignore[operator]

    return note


def test_a_program_without_an_owner_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    owner_module.follow_owner()
    assert owner_variables() == {VARIABLE: f"{os.getpid()} 15"}
