"""Programs import nothing from the folder in which they are started."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from repository import REPOSITORY

from oaisys_core.system.python_programs import python_command, python_environment

PLANTED = (
    *("numpy", "random", "yaml", "json", "pydantic", "typing_extensions", "logging", "typer"),
    *("oaisys_msgs", "rclpy", "trimesh", "PIL", "cv2", "bpy", "statistics", "colorsys", "ray"),
)
TRAP = "import pathlib\npathlib.Path(__file__).with_suffix('.run').touch()\nraise SystemExit(77)\n"
PACKAGES = sorted(
    file.parent.name
    for file in REPOSITORY.glob("*/*/__init__.py")
    if file.parent.name == file.parents[1].name
)
STARTS = re.compile(r'sys\.executable, "-m"|python, "-m"')


@pytest.fixture
def trap(tmp_path: Path) -> Path:
    for name in PLANTED:
        (tmp_path / f"{name}.py").write_text(TRAP)
    return tmp_path


def run(command: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    ended = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert not list(folder.glob("*.run")), f"{command} imported from the current folder"
    return ended


BY_HAND = [sys.executable, "-m"]


@pytest.mark.parametrize(
    "command",
    [
        [str(Path(sys.executable).with_name("oaisys")), "config", "check", "world.yaml"],
        [*BY_HAND, "oaisys_core", "config", "check", "world.yaml"],
        [*BY_HAND, "oaisys_grpc", "config", "check", "world.yaml"],
        python_command("oaisys_core", "config", "check", "world.yaml"),
    ],
    ids=["oaisys", "-m oaisys_core", "-m oaisys_grpc", "-P -m"],
)
def test_commands_import_nothing_from_the_current_folder(trap: Path, command: list[str]) -> None:
    (trap / "world.yaml").write_text("stage: {preset: plane, resolution_px: 9}\n")
    assert run(command, trap).returncode == 0


@pytest.mark.parametrize("module", ["oaisys_ros_bridge.namespaces", "oaisys_dataset.places.local"])
def test_a_module_started_by_hand_imports_nothing_from_there(trap: Path, module: str) -> None:
    ended = run([*BY_HAND, module], trap)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("package", PACKAGES)
def test_no_package_imports_a_standard_module_from_there(tmp_path: Path, package: str) -> None:
    """`typing` was imported before the current folder had left the path."""
    empty = tmp_path / "nothing"
    (empty / "nothing").mkdir(parents=True)
    (empty / "nothing/__init__.py").write_text("import sys\nprint(*sys.modules)\n")
    found = subprocess.run(
        [*BY_HAND, "nothing"], cwd=empty, capture_output=True, text=True, timeout=60, check=False
    )
    # What Python imports by itself, before the package, is beyond it.
    for name in sys.stdlib_module_names - set(found.stdout.split()):
        (tmp_path / f"{name}.py").write_text(TRAP)
    run([*BY_HAND, package], tmp_path)


def test_an_empty_entry_of_pythonpath_is_dropped() -> None:
    found = python_environment({"PYTHONPATH": ":/packages:.:"})
    assert found == {"PYTHONPATH": "/packages", "PYTHONSAFEPATH": "1"}


def test_no_program_is_started_another_way() -> None:
    found = [
        f"{file.relative_to(REPOSITORY)}: {line.strip()}"
        for package in (*PACKAGES, "tools")
        for file in (REPOSITORY / package).rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if STARTS.search(line)
    ]
    assert not found
