"""Commands in a folder that somebody has removed: a sentence, instead of a wait for ever."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE_S

REMOVED = 'cd "$0" && rmdir "$0" && exec "$@"'


def run_in_removed_folder(folder: Path, *module: object) -> subprocess.CompletedProcess[str]:
    folder.mkdir()
    command = ["sh", "-c", REMOVED, str(folder), sys.executable, "-P", "-m", *map(str, module)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


@pytest.mark.parametrize("command", ["render", "heights", "audit", "dataset", "serve", "survey"])
def test_a_removed_folder_is_a_sentence(tmp_path: Path, command: str) -> None:
    rest = ("render", tmp_path / "world.yaml") if command == "dataset" else ()
    options = () if command == "serve" else ("--out", tmp_path / "out")
    done = run_in_removed_folder(tmp_path / "gone", "oaisys_core", command, *rest, *options)
    assert done.returncode == 1
    assert done.stderr == (
        "oaisys: the current folder has been removed: change to one that exists\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_help_needs_no_folder(tmp_path: Path) -> None:
    done = run_in_removed_folder(tmp_path / "gone", "oaisys_core", "render", "--help")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.ros
@pytest.mark.parametrize("node", ["bridge", "mapper"])
def test_a_node_says_so_too(tmp_path: Path, node: str) -> None:
    done = run_in_removed_folder(tmp_path / "gone", f"oaisys_ros_bridge.nodes.{node}")
    assert done.returncode == 1
    assert done.stderr == "the current folder has been removed: change to one that exists\n"
