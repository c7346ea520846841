"""Standard streams that are closed or full."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from repository import REPOSITORY

from oaisys_core.system.standard_streams import printable

PROGRAM = [sys.executable, "-P", "-m", "oaisys_core"]


def run(arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command with redirections of the shell."""
    line = f'exec "$@" {arguments}'
    return subprocess.run(
        ["sh", "-c", line, "sh", *PROGRAM],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("closed")
    (folder / "world.yaml").write_text(
        "backend: analytic\nstage: {extent_m: 10, resolution_px: 33, surroundings: plain}\n"
        "materials: {texture_size_px: 16, mask: {size_px: 16, relief: 0}}\nassets: {rocks: []}\n"
        "sensors: {cameras: [{width_px: 8, height_px: 6, modalities: [depth]}]}\n"
    )
    done = run("render --config world.yaml --out out >&-", folder)  # it works with stdout closed
    assert (done.returncode, done.stderr.count("Traceback")) == (0, 0), done.stderr
    return folder


@pytest.mark.parametrize("closed", [">&- 2>&- <&-", pytest.param("<&-", marks=pytest.mark.long)])
def test_a_command_works_with_closed_streams(closed: str, rendered: Path) -> None:
    """`sys.stdout` was None: AttributeError, and files got the numbers of streams."""
    done = run(f"repeat out {closed}", rendered)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_full_standard_output_is_a_sentence(rendered: Path) -> None:
    """It was exit code 120, with "Exception ignored in"."""
    done = run("repeat out >/dev/full", rendered)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "no space left" in done.stderr


def test_control_characters_of_others_do_not_reach_the_terminal() -> None:
    assert printable("a\x1b[2J\u202eb\nc\td") == "a\\x1b[2J\\u202eb\nc\td"


@pytest.mark.parametrize("module", ["gallery", "gallery.look_book", "gallery.imports", "bench"])
@pytest.mark.parametrize("closed", [pytest.param(">&-", marks=pytest.mark.soak), ">&- 2>&- <&-"])
def test_tools_work_with_closed_streams(module: str, closed: str) -> None:
    """It was AttributeError: the process that waits for a child flushes its streams."""
    command = f"exec {sys.executable} -m tools.{module} --no-such-option {closed}"
    done = subprocess.run(
        ["sh", "-c", command], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr


HOOK = """\
import os, sys

class Looking:
    def find_spec(self, name, path=None, target=None):
        if name == "rclpy":
            for number in range(3):
                os.fstat(number)

sys.meta_path.insert(0, Looking())
"""


@pytest.mark.ros
@pytest.mark.parametrize("node", ["bridge", "mapper", "player", "recorder", "drive"])
def test_nodes_open_closed_streams_before_ros_is_loaded(node: str, tmp_path: Path) -> None:
    """What ROS opens while it is loaded got the numbers of streams."""
    (tmp_path / "sitecustomize.py").write_text(HOOK)
    command = f"exec {sys.executable} -m oaisys_ros_bridge.nodes.{node} --no-such-option >&- <&-"
    done = subprocess.run(
        ["sh", "-c", command],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
