"""The `oaisys` command itself, with sub-commands of a third-party package."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from commands import oaisys_here
from repository import REPOSITORY
from typer.main import get_command

from oaisys_core.cli.main import _commands_by_name, app

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


@pytest.fixture
def third_party_here(third_party: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The same package, installed for this process."""
    monkeypatch.syspath_prepend(third_party)
    _commands_by_name.cache_clear()
    yield
    _commands_by_name.cache_clear()
    sys.modules.pop("third_party", None)


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


@pytest.mark.usefixtures("third_party_here")
def test_group_of_another_package_keeps_its_sub_commands() -> None:
    result = oaisys_here("group", "two")
    assert (result.returncode, result.stdout) == (0, "two\n")


@pytest.mark.usefixtures("third_party_here")
def test_help_lists_every_command_and_says_which_is_not_available() -> None:
    result = oaisys_here("--help")
    assert result.returncode == 0
    for name in ("good", "refused", "group", "broken", "serve", "survey", "render", "config"):
        assert name in result.stdout.split()
    assert "Count sheep." in result.stdout
    assert "third_party_without_its_library" in " ".join(result.stdout.split())


@pytest.mark.usefixtures("third_party_here")
@pytest.mark.parametrize(
    ("command", "exit_code", "message"),
    [
        ("refused", 2, "sensors.0.width_px: received -1, expected a positive integer"),
        ("misconfigured", 2, "seed: missing"),
        ("failed", 1, "out of memory"),
        ("broken", 1, "the command 'broken' is not available"),
    ],
)
def test_errors_are_one_line_and_an_exit_code(command: str, exit_code: int, message: str) -> None:
    result = oaisys_here(command)
    assert result.returncode == exit_code
    assert result.stdout == ""
    assert len(result.stderr.splitlines()) == 1
    assert message in result.stderr


def test_command_may_choose_its_exit_code(third_party: Path) -> None:
    assert oaisys(third_party, "threshold-missed").returncode == 1


@pytest.mark.usefixtures("third_party_here")
@pytest.mark.parametrize("arguments", [("sheep",), ("good", "--count", "x"), ("good", "--wool")])
def test_wrong_usage_exits_with_2(arguments: tuple[str, ...]) -> None:
    assert oaisys_here(*arguments).returncode == 2


def test_verbose_shows_where_an_error_came_from(third_party: Path) -> None:
    assert "Traceback" in oaisys(third_party, "-vv", "failed").stderr


CONFIG_LIBRARIES = {"numpy", "pydantic", "yaml"}
"""What reading a configuration needs."""

SLOW_LIBRARIES = {
    *("OpenEXR", "PIL", "bpy", "cryptography", "cv2", "google", "grpc", "jinja2", "matplotlib"),
    *("mcap", "open3d", "rasterio", "rclpy", "rich", "rosidl_parser", "shapely", "trimesh"),
    *("scipy.fft", "scipy.interpolate", "scipy.linalg", "scipy.ndimage", "scipy.optimize"),
    *("scipy.sparse", "scipy.spatial", "scipy.special", "scipy.stats", "sensor_msgs"),
}
"""What takes a tenth of a second or more to import, and belongs into the functions that use it."""


def imported_by(*commands: str) -> tuple[list[set[str]], str]:
    """Return which slow libraries a process has after each of some commands, and all it prints."""
    code = f"""
import sys
from oaisys_core.cli.main import main
for command in {commands!r}:
    sys.argv = ["oaisys", *command.split()]
    try:
        main()
    except SystemExit as end:
        assert not end.code, command
    print(*{CONFIG_LIBRARIES | SLOW_LIBRARIES} & sys.modules.keys(), file=sys.stderr)
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return [set(line.split()) for line in result.stderr.splitlines()], result.stdout


def test_help_imports_nothing_that_takes_long() -> None:
    commands = ("--help", *(f"{' '.join(names)} --help" for names in command_names()))
    (of_list, *of_commands), printed = imported_by(*commands)
    assert of_list == set()
    assert "  survey  " in printed
    assert printed.count("Usage: oaisys") == len(commands)
    # typer checks the arguments of a command with pydantic.
    for command, imported in zip(commands[1:], of_commands, strict=True):
        assert imported <= {"pydantic"}, command


def test_a_configuration_is_checked_without_the_libraries_that_render_and_read_files() -> None:
    imported, printed = imported_by(f"config check {REPOSITORY / 'config/simulator.yaml'}")
    assert imported == [CONFIG_LIBRARIES]
    assert "valid" in printed


def command_names() -> list[tuple[str, ...]]:
    """Every command that is installed, and those inside of it."""
    root: Any = get_command(app)
    names: list[tuple[str, ...]] = []
    for name in root.list_commands(None):
        names.append((name,))
        parts = getattr(root.get_command(None, name), "commands", {})
        names += [(name, part) for part in parts]
    return names


@pytest.mark.parametrize("arguments", command_names(), ids=" ".join)
def test_help_is_readable_at_80_columns(
    monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    result = oaisys_here(*arguments, "--help")
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert "…" not in result.stdout
    assert not any(line.endswith("...") for line in lines[1:])  # the usage ends in ARGS...
    # The column of help texts begins after an option, or stands alone below a long one.
    rows = [re.match(r"  \S+(?: \S+)*  +(?=\S)|   +(?=\S)", line) for line in lines]
    assert all(80 - row.end() >= 40 for row in rows if row), result.stdout
