"""The `oaisys` command itself, with sub-commands of a third-party package."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

OAISYS = Path(sys.executable).with_name("oaisys")

THIRD_PARTY = '''
import typer
from oaisys_core.errors import ConfigError, InvalidInputError, RenderError

def good(count: int = 1) -> None:
    """Count sheep."""
    print("sheep", count)

def refused() -> None:
    raise InvalidInputError("sensors.0.width_px", -1, "a positive integer")

def misconfigured() -> None:
    raise ConfigError("seed: missing")

def failed() -> None:
    raise RenderError("out of memory")

def threshold_missed() -> None:
    raise typer.Exit(1)

group = typer.Typer()

@group.command()
def one() -> None:
    print("one")

@group.command()
def two() -> None:
    print("two")
'''

ENTRY_POINTS = """
[oaisys.commands]
good = third_party:good
refused = third_party:refused
misconfigured = third_party:misconfigured
failed = third_party:failed
threshold-missed = third_party:threshold_missed
group = third_party:group
broken = third_party_without_its_library:run
"""


@pytest.fixture
def third_party(tmp_path: Path) -> Path:
    (tmp_path / "third_party.py").write_text(THIRD_PARTY)
    info = tmp_path / "third_party-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: third_party\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    return tmp_path


def oaisys(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [OAISYS, *arguments],
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_command_of_another_package_runs(third_party: Path) -> None:
    result = oaisys(third_party, "good", "--count", "3")
    assert (result.returncode, result.stdout) == (0, "sheep 3\n")


def test_group_of_another_package_keeps_its_sub_commands(third_party: Path) -> None:
    result = oaisys(third_party, "group", "two")
    assert (result.returncode, result.stdout) == (0, "two\n")


def test_help_lists_every_command_and_says_which_is_not_available(third_party: Path) -> None:
    result = oaisys(third_party, "--help")
    assert result.returncode == 0
    for name in ("good", "refused", "group", "broken", "serve", "survey", "render", "config"):
        assert f" {name} " in result.stdout
    assert "Count sheep." in result.stdout
    assert "third_party_without_its_library" in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    ("command", "exit_code", "message"),
    [
        ("refused", 2, "sensors.0.width_px: received -1, expected a positive integer"),
        ("misconfigured", 2, "seed: missing"),
        ("failed", 1, "out of memory"),
        ("broken", 1, "the command 'broken' is not available"),
    ],
)
def test_errors_are_one_line_and_an_exit_code(
    third_party: Path, command: str, exit_code: int, message: str
) -> None:
    result = oaisys(third_party, command)
    assert result.returncode == exit_code
    assert result.stdout == ""
    assert len(result.stderr.splitlines()) == 1
    assert message in result.stderr


def test_command_may_choose_its_exit_code(third_party: Path) -> None:
    assert oaisys(third_party, "threshold-missed").returncode == 1


@pytest.mark.parametrize("arguments", [("sheep",), ("good", "--count", "x"), ("good", "--wool")])
def test_wrong_usage_exits_with_2(third_party: Path, arguments: tuple[str, ...]) -> None:
    result = oaisys(third_party, *arguments)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr


def test_verbose_shows_where_an_error_came_from(third_party: Path) -> None:
    assert "Traceback" in oaisys(third_party, "-vv", "failed").stderr
