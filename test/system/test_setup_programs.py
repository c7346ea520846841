"""Programs that the set-up starts: their progress is shown, and nothing of them stays."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import psutil
import pytest
from repository import REPOSITORY
from waiting import wait_until

from tools.setup.errors import SetupError
from tools.setup.installers import pip_progress
from tools.setup.programs import Display, ProgramProgress, Programs


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_long_program_is_told_of_while_it_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "state" / "log"
    code = (
        "import time\nfor index in range(4):\n    print('Collecting', index, flush=True)\n"
        "    time.sleep(0.3)\nexit(3)"
    )
    ended = Programs(Display(every_s=0.1)).run(
        [sys.executable, "-c", code],
        os.environ,
        log,
        lambda said: pip_progress(said, 4, tmp_path),
    )
    assert ended == 3
    assert log.read_text() == "".join(f"Collecting {index}\n" for index in range(4))
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) > 4
    told = [re.fullmatch(r"setup:   (\d) of 4 packages collected, \d+ s", line) for line in lines]
    counts = [int(found[1]) for found in told if found]
    assert len(counts) == len(lines)
    assert counts == sorted(counts)
    assert counts[-1] == 4


def test_a_terminal_shows_one_bar_below_the_lines() -> None:
    terminal = Terminal()
    display = Display(terminal)
    display.show(ProgramProgress("1 of 4 packages", 0.25), 3.2)
    display.show(ProgramProgress("4 of 4 packages", 1.5), 7.0)
    display.say("done")
    shown = terminal.getvalue().split("\r\x1b[K")
    assert shown == [
        "",
        "setup: [#####...............] 1 of 4 packages, 3 s",
        "setup: [####################] 4 of 4 packages, 7 s",
        "setup: done\n",
    ]


def test_a_program_that_takes_too_long_is_killed(tmp_path: Path) -> None:
    programs = Programs(Display())
    assert programs.run(["sleep", "600"], os.environ, tmp_path / "log", timeout_s=0.2) == -9


def test_a_stopped_set_up_leaves_no_program_nor_its_children(tmp_path: Path) -> None:
    programs = Programs(Display())
    log = tmp_path / "log"
    faults: list[SetupError] = []

    def run() -> None:
        try:
            programs.run(["sh", "-c", "sleep 600 & echo $!; wait"], os.environ, log)
        except SetupError as error:
            faults.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    wait_until(lambda: log.is_file() and log.read_text().endswith("\n"))
    child = int(log.read_text())
    programs.stop()
    thread.join(60)
    assert len(faults) == 1
    wait_until(
        lambda: (
            not psutil.pid_exists(child) or psutil.Process(child).status() == psutil.STATUS_ZOMBIE
        )
    )
    with pytest.raises(SetupError):
        programs.run(["true"], os.environ, log)


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_set_up_with_what_it_has_started(tmp_path: Path, ending: int) -> None:
    log = tmp_path / "pid"
    code = f"""
import os, signal, sys
from pathlib import Path
import tools.setup.__main__ as setup
from tools.setup.steps import SetupStep
def stages(environment, programs):
    sleep = ["sh", "-c", "echo $$; exec sleep 600"]
    run = lambda _: programs.run(sleep, os.environ, Path({str(log)!r}))
    return [[SetupStep("a", "a", "key", run)]]
setup._stages = stages
sys.argv[1:] = ["--venv", {str(tmp_path / "venv")!r}]
# A job of a shell without job control ignores SIGINT.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(setup.main())
"""
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=REPOSITORY, stderr=subprocess.PIPE, text=True
    ) as setup:
        wait_until(lambda: log.is_file() and log.read_text().endswith("\n"), process=setup)
        child = int(log.read_text())
        setup.send_signal(ending)
        told = setup.communicate(timeout=60)[1]
    assert setup.returncode == 130
    assert told.splitlines()[-1] == "setup: interrupted; run it again"
    assert not psutil.pid_exists(child)
