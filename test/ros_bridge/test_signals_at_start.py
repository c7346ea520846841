"""A signal while a command is loaded ends it, even where a library drops the interruption."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import LOAD_FACTOR

START_S = 12.0
"""For a command to be loaded and to end."""

HOOK = """\
import os, signal, sys, time

class Dropping:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["TEST_MODULE"]:
            sys.meta_path.remove(self)
            try:
                os.kill(os.getpid(), int(os.environ["TEST_SIGNAL"]))
                time.sleep(0.05)
            except BaseException:  # as trimesh does around its import of networkx
                pass

sys.meta_path.insert(0, Dropping())
"""

WORLD = "backend: analytic\nstage: {preset: mounds, extent_m: 16, resolution_px: 65}\n"


def end_of(folder: Path, module: str, number: signal.Signals, *arguments: str) -> tuple[int, str]:
    """Run a command that gets a signal, which is dropped, where it imports a module."""
    (folder / "hook").mkdir()
    (folder / "hook" / "sitecustomize.py").write_text(HOOK)
    (folder / "world.yaml").write_text(WORLD)
    given = {"TEST_MODULE": module, "TEST_SIGNAL": str(int(number))}
    done = subprocess.run(
        [sys.executable, "-m", "oaisys_core", *arguments],
        env={**os.environ, "PYTHONPATH": str(folder / "hook"), **given},
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LOAD_FACTOR * START_S,
        check=False,
    )
    return done.returncode, done.stderr


@pytest.mark.usefixtures("no_process_left")
@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGTERM, marks=pytest.mark.soak), signal.SIGINT]
)
@pytest.mark.parametrize(
    ("module", "command"),
    [
        ("networkx", "view --address 127.0.0.1:1 --port 0"),
        ("networkx", "live --config world.yaml --port 0"),
        ("oaisys_grpc.server.server", "serve --config world.yaml --address 127.0.0.1:0"),
        ("oaisys_ros_bridge.experiments.explore.explore", "explore --config world.yaml"),
        ("oaisys_ros_bridge.experiments.survey.survey", "survey --config world.yaml"),
        ("oaisys_ros_bridge.nodes.recorder", "record --out bag"),
        ("oaisys_ros_bridge.nodes.player", "bag replay bag"),
        ("oaisys_core.system.machine_checks", "doctor"),
    ],
)
def test_a_dropped_signal_ends_a_command_that_is_loaded(
    module: str, command: str, number: signal.Signals, tmp_path: Path, ros_domain_id: int
) -> None:
    """`oaisys view` and `live` ran for ever; trimesh had dropped the interruption."""
    code, told = end_of(tmp_path, module, number, *command.split())
    assert code == 128 + number, told
    assert "Traceback" not in told
