"""Long commands end at a signal with one exit code each, and leave nothing, whatever they do."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import cycle
from pathlib import Path

import pytest
from small_datasets import SMALL, render_dataset
from waiting import PATIENCE_S, SHUTDOWN_S, START_PATIENCE_S, wait_until, within

from oaisys_core.system.ending.leftovers import Leftovers

MARK = "OAISYS_TEST_SIGNALS"
ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)

CONFIG = """\
backend: analytic
stage: {extent_m: 16, resolution_px: 65, surroundings: plain}
materials: {texture_size_px: 64, mask: {size_px: 64, relief: 0}}
assets: {rocks: [{count: [4, 4], variants: 1}]}
sensors: {cameras: [{width_px: 32, height_px: 24, modalities: [depth, semantic_0, instance]}]}
"""


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("config") / "world.yaml"
    path.write_text(CONFIG)
    return path


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset") / "set"
    render_dataset(folder, {0: "train"}, 4, SMALL)
    return folder


class Command:
    """A command with temporary files of its own."""

    def __init__(self, folder: Path, *arguments: object) -> None:
        self.temporary = folder / "tmp"
        self.temporary.mkdir()
        self._mark = f"{MARK}={folder}".encode()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "oaisys_core", *map(str, arguments)],
            env={**os.environ, "TMPDIR": str(self.temporary), MARK: str(folder)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            text=True,
        )

    def processes(self) -> list[str]:
        """Return the command lines of the processes of this command that run."""
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdecimal():
                try:
                    if self._mark in (entry / "environ").read_bytes().split(b"\0"):
                        found.append((entry / "cmdline").read_text())
                except OSError:
                    continue  # it has ended, or is another user's
        return found

    def works(self) -> bool:
        """Return whether the process that works has been started: signals are handled."""
        return len(self.processes()) > 1

    def ended_by(self, number: signal.Signals, *, twice: bool = False) -> str:
        """Send a signal, see that it ends the command as promised, and return what it said."""
        with within(SHUTDOWN_S):
            self.process.send_signal(number)
            if twice:
                with suppress(ProcessLookupError):  # it has ended already
                    os.killpg(self.process.pid, number)
            _, told = self.process.communicate(timeout=PATIENCE_S)
        assert self.process.returncode == 128 + number, told
        assert not self.processes()
        assert not list(self.temporary.iterdir())
        assert "Traceback" not in told
        assert "***" not in told
        return told


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Command]]:
    started: list[Command] = []

    def begin(*arguments: object) -> Command:
        folder = tmp_path / str(len(started))
        folder.mkdir()
        started.append(Command(folder, *arguments))
        return started[-1]

    yield begin
    for command in started:
        command.process.kill()
        command.process.communicate(timeout=PATIENCE_S)


COMMANDS = ("render", "audit", "check", "export", "repeat")


@pytest.mark.parametrize(("name", "number"), list(zip(COMMANDS, cycle(ENDINGS), strict=False)))
def test_a_signal_at_any_moment_has_one_exit_code_and_leaves_nothing(
    name: str,
    number: signal.Signals,
    start: Callable[..., Command],
    config: Path,
    dataset: Path,
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    arguments = {
        "render": ("render", "--config", config, "--out", out, "--samples", 1000),
        "audit": ("audit", "--config", config, "--views", 1000),
        "check": ("dataset", "check", dataset, "--worlds-rebuilt", 1),
        "export": ("dataset", "export", dataset, "--format", "hdf5", "--out", out),
        "repeat": ("dataset", "repeat", dataset, *["000000_0001_camera"] * 500),
    }[name]
    draws = random.Random(f"{name} {os.getpid()}")
    command = start(*arguments)
    wait_until(command.works, START_PATIENCE_S, process=command.process)
    time.sleep(draws.uniform(0, 1.0))  # any moment, from the first import on
    told = command.ended_by(number, twice=draws.random() < 0.5)
    assert f"stopped by {number.name}" in told
    assert not list(tmp_path.rglob("*.part*"))


def end_of(code: str, number: signal.Signals) -> int:
    """Send a signal to a program that has printed a line, and return how it ends."""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.1)
        process.send_signal(number)
        return process.wait(PATIENCE_S)


def test_a_signal_before_the_work_begins_is_an_exit_code(start: Callable[..., Command]) -> None:
    code = "from oaisys_core.cli.program import main; import time; print(flush=True); "
    code += "from oaisys_core.system.ending.signals import exit_at_signals; "
    code += "exit_at_signals(); time.sleep(60)"
    for number in ENDINGS:
        assert end_of(code, number) == 128 + number


def test_a_second_signal_does_not_kill_a_program_that_ends_well() -> None:
    """Python restores the signals' defaults before it runs what is left to do at its exit."""
    code = "import sys, threading, time; "
    code += "from oaisys_core.system.ending.signals import ignore_signals; ignore_signals(); "
    code += "threading.Thread(target=lambda: (time.sleep(0.3), print(flush=True), "
    code += "time.sleep(1))).start(); sys.exit(0)"
    for number in ENDINGS:
        assert end_of(code, number) == 0


def test_signals_are_settled_before_anything_slow_is_imported() -> None:
    code = "import sys; before = set(sys.modules); import oaisys_core.cli.program; "
    code += "print(*sorted(set(sys.modules) - before))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = found.stdout.split()
    assert "oaisys_core.system.ending.signals" in loaded
    slow = {"importlib.resources", "tempfile", "ctypes.util", "subprocess", "typer", "numpy"}
    assert not slow & set(loaded)


@pytest.mark.long
def test_a_data_set_ends_at_a_signal_while_ray_starts_and_while_it_renders(
    start: Callable[..., Command], config: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"

    def ray_starts(command: Command) -> bool:
        return any("session_guard" in each for each in command.processes())

    def world_is_rendered(_: Command) -> bool:
        return any(out.glob("shards/*.jsonl"))

    moments = ((signal.SIGTERM, ray_starts), (signal.SIGINT, world_is_rendered))
    for number, moment in moments:
        arguments = ("--worlds", 1000, "--views", 1, "--num-workers", 1, "--resume")
        command = start("dataset", "render", config, "--out", out, *arguments)
        wait_until(lambda: moment(command), START_PATIENCE_S, process=command.process)  # noqa: B023
        time.sleep(random.uniform(0, 1.0))
        guards = [each for each in command.processes() if "session_guard" in each]
        command.ended_by(number, twice=True)
        assert not any(Path(guard.split("\0")[-2]).exists() for guard in guards)
        assert not list(out.rglob(".*"))


def test_what_is_written_down_is_removed_and_slots_are_used_again(tmp_path: Path) -> None:
    record = Leftovers()
    file, folder, gone = tmp_path / "file", tmp_path / "folder", tmp_path / "gone"
    file.write_text("")
    (folder / "deep").mkdir(parents=True)
    record.drop(record.add(tmp_path / "kept"))
    for path in (file, folder, gone):
        record.add(path)
    (tmp_path / "kept").write_text("")
    assert record.paths() == [file, folder, gone]
    record.remove()
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
