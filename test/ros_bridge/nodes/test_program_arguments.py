"""The arguments of the nodes' programs: help ends them, and so does what nobody knows."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from ros_peer import Stage
from waiting import PATIENCE_S, wait_until

from oaisys_ros_bridge.nodes import bridge, drive, mapper, player, recorder
from oaisys_ros_bridge.parameters.reference import NODES

pytestmark = pytest.mark.ros

PROGRAMS: dict[str, Callable[..., int]] = {
    "bridge": bridge.main,
    "drive": drive.main,
    "mapper": mapper.main,
    "player": player.main,
    "recorder": recorder.main,
}
MALFORMED = (
    ["-p", "rate"],
    ["-p", ":=3"],
    ["-p", "rate:=[1, word"],
    ["-r"],
    ["-r", "image"],
    ["-r", "__ns:=//mars moon"],
    ["-r", "__node:=two words"],
    ["--params-file", "/nonexistent"],
    ["--log-level", "loud"],
    ["--no-such"],
    ["-p", "rate:=\udcff"],
)
MALFORMED_FOR_A_NODE = (
    ["-p", "use_sim_time:=maybe"],
    ["-p", "start_type_description_service:=5"],
    ["-e", "relative"],
    ["--log-config-file", "/nonexistent"],
)
"""What ROS takes for arguments until a node is to be made of them."""


def end(program: Callable[..., int], *arguments: str) -> int:
    """Run a program that is to end at once; return its exit code."""
    with pytest.raises(SystemExit) as ending:
        program(["program", *arguments])
    assert isinstance(ending.value.code, int)
    return ending.value.code


def test_every_program_of_a_node_is_here() -> None:
    files = (Path(bridge.__file__).parent).glob("*.py")
    assert {file.stem for file in files if "__main__" in file.read_text()} == PROGRAMS.keys()


def test_help_ends_a_program_that_a_user_runs(ros_domain_id: int) -> None:
    """It started a node, which never returned."""
    command = [sys.executable, "-m", "oaisys_ros_bridge.nodes.bridge"]
    told = subprocess.run(
        [*command, "--help"], capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    assert "-p address:=" in told.stdout
    assert told.stderr == ""


@pytest.mark.parametrize("name", PROGRAMS)
def test_help_lists_parameters_and_an_example(name: str, capsys: pytest.CaptureFixture) -> None:
    assert end(PROGRAMS[name], "--help") == 0
    text, errors = capsys.readouterr()
    assert not errors
    assert f"example:\n  python -P -m oaisys_ros_bridge.nodes.{name} " in text
    for row in (row for node in NODES if node.executable == name for row in node.parameters):
        assert f"  {row.name} (default " in text
        assert row.description in text


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("argument", ["--no-such", "stray", "--helpp"])
def test_an_argument_that_nobody_knows_is_exit_2(
    name: str, argument: str, capsys: pytest.CaptureFixture
) -> None:
    assert end(PROGRAMS[name], "--ros-args", "-r", "a:=b", "--", argument) == 2
    assert f"unrecognized arguments: {argument}" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", MALFORMED, ids=" ".join)
def test_arguments_that_ros_cannot_use_are_exit_2(
    arguments: list[str], capsys: pytest.CaptureFixture
) -> None:
    for program in PROGRAMS.values():
        assert end(program, "--ros-args", *arguments) == 2
        text = capsys.readouterr().err
        assert "expected what ROS can use" in text
        assert "Traceback" not in text
        assert "/project/" not in text


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("arguments", MALFORMED_FOR_A_NODE, ids=" ".join)
def test_arguments_of_which_no_node_can_be_made_are_exit_2(
    name: str, arguments: list[str], ros_domain_id: int
) -> None:
    """The drive program had a traceback, or took them without a word."""
    command = [sys.executable, "-P", "-m", f"oaisys_ros_bridge.nodes.{name}", "--ros-args"]
    ended = subprocess.run(
        [*command, *arguments], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    (sentence,) = ended.stderr.splitlines()
    assert f"arguments: received '--ros-args {' '.join(arguments)}', expected what ROS" in sentence
    assert ended.returncode == 2


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_program_names_parameters_that_its_node_does_not_have(
    name: str, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    log = stage.start_node(name, "--ros-args", "-p", "adress:=x").log
    wait_until(lambda: "parameter 'adress' is unknown here" in log.read_text())


@pytest.mark.parametrize("text", ["{", "[]", "NaN", '{"duration_s": NaN}'])
def test_keys_of_a_drive_are_read_before_anything_waits(
    text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """They were looked at after a bridge was ready, for which it waits five minutes."""
    monkeypatch.setattr(drive, "DriveClient", None)
    assert drive.main(["drive", "--drive-json", text]) == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith(f"drive: drive_json: received {text!r}, expected a JSON object")


@pytest.mark.parametrize("executable", ["bridge", "drive", "mapper"])
def test_too_few_files_for_a_node_are_a_sentence(executable: str, ros_domain_id: int) -> None:
    limited = ["bash", "-c", 'ulimit -n 20; exec "$@"', "--"]
    command = [sys.executable, "-P", "-m", f"oaisys_ros_bridge.nodes.{executable}"]
    ended = subprocess.run(
        [*limited, *command], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert "this process may open no more files (ulimit -n)" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert ended.returncode == 1
