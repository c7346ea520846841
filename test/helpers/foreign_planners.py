"""Planners of another package that fail each in its way, installed for a test's processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NoReturn

from oaisys_core.types import Pose
from oaisys_mapping.exploration.planner import Planner, Situation
from oaisys_mapping.exploration.planners import RandomPlanner


class Stuck(Planner):
    """Never answers, whatever is raised in it, and has started a program."""

    name = "stuck"

    def next_pose(self, situation: Situation) -> NoReturn:
        subprocess.Popen(["sleep", "1000"])
        while True:
            try:
                time.sleep(1000)
            except BaseException:  # noqa: BLE001
                continue


class Crashing(Planner):
    """Ends its process as a fault in native code does."""

    name = "crashing"

    def next_pose(self, situation: Situation) -> Pose | None:
        os.kill(os.getpid(), signal.SIGSEGV)
        return None


class Leaving(Planner):
    """Ends the program that it takes itself for."""

    name = "leaving"

    def next_pose(self, situation: Situation) -> NoReturn:
        sys.exit(0)


class Unmade(Planner):
    """Cannot be made."""

    name = "unmade"

    def __init__(self) -> None:
        raise RuntimeError("weights.pt is missing")

    def next_pose(self, situation: Situation) -> Pose | None:
        return None


class Working(RandomPlanner):
    """Does what `RandomPlanner` does."""

    name = "working"


KINDS = (Stuck, Crashing, Leaving, Unmade, Working)


def install_planners(folder: Path) -> dict[str, str]:
    """Return the variables with which a process finds all of them, by their names."""
    package = folder / "foreign_planners-1.dist-info"
    package.mkdir(parents=True)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-planners\nVersion: 1\n")
    lines = [f"{kind.name} = {__name__}:{kind.__name__}\n" for kind in KINDS]
    (package / "entry_points.txt").write_text("".join(("[oaisys.planners]\n", *lines)))
    folders = (str(folder), str(Path(__file__).parent), os.environ.get("PYTHONPATH", ""))
    return {"PYTHONPATH": os.pathsep.join(filter(None, folders))}
