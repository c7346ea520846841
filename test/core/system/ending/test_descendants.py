"""What another's program has started ends with it, also in sessions of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from waiting import PATIENCE_S, wait_until

from oaisys_core.system import processes
from oaisys_core.system.ending.descendants import command_with_descendants
from oaisys_core.system.processes import ManagedProcess

DAEMONS = "setsid sleep 1000 & (setsid sh -c 'sleep 1000 & sleep 1000' &); "
OWNER = """
import subprocess, sys, time
from oaisys_core.system.ending.descendants import command_with_descendants
subprocess.Popen(command_with_descendants(sys.argv[1:]))
time.sleep(1000)
"""


def start(script: str) -> subprocess.Popen[str]:
    """Start a script of the shell, and wait for its first line."""
    command = command_with_descendants(["sh", "-c", script])
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stdout is not None
    process.stdout.readline()
    return process


@pytest.mark.usefixtures("no_process_left")
@pytest.mark.parametrize(("end", "code"), [("exit 3", 3), ("kill -SEGV $$", -signal.SIGSEGV)])
def test_a_program_that_ends_leaves_nothing_and_its_code_is_passed_on(end: str, code: int) -> None:
    with start(f"{DAEMONS} echo; {end}") as process:
        assert process.wait(PATIENCE_S) == code


@pytest.mark.usefixtures("no_process_left")
def test_an_order_ends_all_of_it_also_what_is_stopped() -> None:
    with start(f"trap '' TERM INT; {DAEMONS} echo; kill -STOP 0; sleep 1000") as process:
        process.terminate()
        assert process.wait(PATIENCE_S) == 128 + signal.SIGTERM


@pytest.mark.usefixtures("no_process_left")
def test_a_request_to_end_reaches_the_program() -> None:
    with start(f"trap 'exit 5' INT; {DAEMONS} echo; sleep 1000 & wait") as process:
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 5


@pytest.mark.usefixtures("no_process_left")
def test_all_of_it_ends_with_the_owner(tmp_path: Path) -> None:
    told = tmp_path / "told"
    command = ["sh", "-c", f"{DAEMONS} echo > {told}; sleep 1000"]
    with subprocess.Popen([sys.executable, "-c", OWNER, *command]) as owner:
        wait_until(told.exists)
        owner.kill()


@pytest.mark.usefixtures("no_process_left")
def test_a_managed_program_that_ignores_all_signals_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "END_TIMEOUT_S", 0.2)
    monkeypatch.setattr(processes, "LAST_WORDS_S", 0.2)
    script = f"trap '' INT TERM HUP ABRT; {DAEMONS} echo ready; while true; do sleep 1; done"
    command = command_with_descendants(["sh", "-c", script])
    with ManagedProcess("it", command, tmp_path / "log", os.environ) as it:
        it.wait_for_line("ready", PATIENCE_S)
        time.sleep(0.1)


def test_a_program_that_is_not_there_is_told_by_name() -> None:
    command = command_with_descendants(["no-such-program"])
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (127, "no-such-program: No such file or directory\n")
