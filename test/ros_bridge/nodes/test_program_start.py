"""While a node's program loads ROS: signals have their exit code, and full memory is a sentence."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from itertools import cycle
from pathlib import Path
from types import SimpleNamespace

import pytest
from waiting import PATIENCE_S

from oaisys_core.errors import ShortageError
from oaisys_ros_bridge import programs
from oaisys_ros_bridge.shared_memory import require_shared_memory

pytestmark = pytest.mark.ros

NODES = ("bridge", "drive", "mapper", "player", "recorder")
SCRIPTS = ("bridge", "mapper", "player", "recorder")
MODULES = [["-m", f"oaisys_ros_bridge.nodes.{name}"] for name in NODES]
_SCRIPT = "import sys; from oaisys_ros_bridge.programs import {0}; sys.exit({0}())"
STARTS = [*MODULES, ["-c", _SCRIPT.format("recorder")]]
"""All scripts differ in the name alone."""
SLOW_RCLPY = "import time; print('loading', flush=True); time.sleep(600)"
FULL = (
    "mount -t tmpfs -o size=64k tmpfs /dev/shm && "
    '{ head -c 100000 /dev/zero > /dev/shm/filler 2> /dev/null; exec "$@"; }'
)
PRIVATE = ["unshare", "--mount", "--propagation", "private"]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


@pytest.mark.parametrize(("start", "number"), list(zip(STARTS, cycle(SIGNALS), strict=False)))
def test_a_signal_while_ros_is_loaded_is_an_exit_code(
    start: list[str], number: signal.Signals, tmp_path: Path
) -> None:
    (tmp_path / "rclpy.py").write_text(SLOW_RCLPY)
    with subprocess.Popen(
        [sys.executable, "-P", *start],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as program:
        try:
            assert program.stdout is not None
            assert program.stdout.readline() == "loading\n"
            program.send_signal(number)
            _, told = program.communicate(timeout=PATIENCE_S)
        finally:
            program.kill()
    assert (program.returncode, told) == (128 + number, "")


@pytest.mark.parametrize(
    "start",
    [*STARTS, ["-m", "oaisys_core", "explore"], ["-m", "oaisys_core", "survey"]],
    ids=" ".join,
)
def test_full_shared_memory_is_a_sentence(start: list[str], tmp_path: Path) -> None:
    if subprocess.run([*PRIVATE, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user must not mount a file system")
    ended = subprocess.run(
        [*PRIVATE, "sh", "-c", FULL, "--", sys.executable, "-P", *start],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        cwd=tmp_path,
    )
    assert ended.returncode == 1, ended.stderr
    assert "/dev/shm is full: ROS cannot be loaded without shared memory" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


DRIVE = """\
stage: {extent_m: 24, resolution_px: 33}
assets: {rocks: []}
sensors:
  cameras:
  - {width_px: 64, height_px: 48, modalities: [depth], rate_hz: 2, mount_position_m: [0, 0, 2]}
render: {quality: geometry}
drive: {vehicle: {kind: rover}, waypoints_m: [[-4, -3], [3, 2]], duration_s: 1}
"""


def test_full_shared_memory_is_a_sentence_of_commands_that_load_ros(tmp_path: Path) -> None:
    """`oaisys drive` and `oaisys repeat BAG` were ended by SIGBUS, the former after the drive."""
    if subprocess.run([*PRIVATE, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user must not mount a file system")
    (tmp_path / "drive.yaml").write_text(DRIVE)
    drive = ["drive", "--config", "drive.yaml", "--backend", "analytic", "--out"]
    program = [sys.executable, "-P", "-m", "oaisys_core"]
    subprocess.run([*program, *drive, "whole"], cwd=tmp_path, check=True, capture_output=True)
    for arguments in ([*drive, "out"], ["repeat", "whole/bag"]):
        ended = subprocess.run(
            [*PRIVATE, "sh", "-c", FULL, "--", *program, *arguments],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
        )
        assert ended.returncode == 1, ended.stderr
        expected = "oaisys: /dev/shm is full: ROS cannot be loaded without shared memory"
        assert expected in ended.stderr.splitlines()


def test_a_full_folder_is_no_lack_where_lttng_has_its_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    own = tmp_path / f"lttng-ust-wait-6-{os.getuid()}"
    with own.open("wb") as file:
        file.truncate(4096)
    with pytest.raises(ShortageError, match=f"{tmp_path} is full"):
        require_shared_memory(tmp_path)
    own.write_bytes(bytes(4096))
    require_shared_memory(tmp_path)


def test_scripts_of_all_nodes_settle_signals_first() -> None:
    setup = Path(programs.__file__).parents[1] / "setup.cfg"
    for name in SCRIPTS:
        assert f"    {name} = oaisys_ros_bridge.programs:{name}\n" in setup.read_text()
