"""Folders that are removed although the process that made them was killed."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

from waiting import PATIENCE_S

from oaisys_core.system.owned_folders import OwnedFolder, remove_abandoned, remove_if_abandoned

OWN = """
import os, sys
from pathlib import Path
from oaisys_core.system.owned_folders import OwnedFolder
own = OwnedFolder("a-", Path(sys.argv[1]))
print(own.path, flush=True)
sys.stdin.read()
os._exit(0)
"""
"""Makes a folder, names it, and ends without its removal once standard input ends."""


def leave(folder: Path) -> Path:
    """Have another process make a folder, and end."""
    command = [sys.executable, "-c", OWN, str(folder)]
    made = subprocess.run(command, input="", capture_output=True, text=True, check=True)
    return Path(made.stdout.rstrip())


def test_the_end_of_an_owner_that_is_under_way_is_waited_for(tmp_path: Path) -> None:
    """A server ended with its killed owner while a thread of that still held the lock."""
    command = [sys.executable, "-c", OWN, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as owner:  # type: ignore[call-overload]
        folder = Path(owner.stdout.readline().rstrip())
        remove_if_abandoned(folder, 0.05)
        assert folder.is_dir()
        ending = threading.Timer(0.1, owner.stdin.close)
        ending.start()
        remove_if_abandoned(folder, PATIENCE_S)
        assert not folder.exists()
        ending.join()


def test_folders_of_the_dead_alone_are_removed(tmp_path: Path) -> None:
    left, named = leave(tmp_path), leave(tmp_path)
    named = named.rename(tmp_path / "b")
    (tmp_path / "a-other").mkdir()
    (tmp_path / "a-link").symlink_to(named)
    with OwnedFolder("a-", tmp_path) as own:
        remove_abandoned("a-", tmp_path)
        remove_if_abandoned(own.path)
        assert own.path.is_dir()
        assert not left.exists()
        assert {each.name for each in tmp_path.iterdir()} - {own.path.name} == {
            "a-other",
            "a-link",
            "b",
        }
    assert not own.path.exists()
    remove_if_abandoned(named)
    assert not named.exists()


def test_a_fork_removes_nothing(tmp_path: Path) -> None:
    with OwnedFolder("a-", tmp_path) as own:
        child = os.fork()
        if not child:
            own.remove()
            os._exit(0)
        os.waitpid(child, 0)
        remove_abandoned("a-", tmp_path)
        assert own.path.is_dir()
