"""A drive and the gallery, ended by a signal: one exit code, the bag finished, nothing left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from repository import REPOSITORY
from waiting import PATIENCE_S, START_PATIENCE_S, wait_until

from oaisys_ros_bridge.bags.info import summary_of
from oaisys_ros_bridge.bags.reading import BagReader

EXAMPLE = REPOSITORY / "config" / "examples" / "rover_drive.yaml"
INT, TERM = signal.SIGINT, signal.SIGTERM

pytestmark = pytest.mark.usefixtures("no_process_left")


def begun(folder: Path, *arguments: object) -> subprocess.Popen[str]:
    """Start a Python program with temporary files of its own."""
    (folder / "tmp").mkdir()
    return subprocess.Popen(
        [sys.executable, "-m", *map(str, arguments)],
        env={**os.environ, "TMPDIR": str(folder / "tmp")},
        cwd=REPOSITORY,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )


def end(process: subprocess.Popen[str], folder: Path, number: signal.Signals) -> None:
    """Send a signal, and see what it leaves."""
    process.send_signal(number)
    try:
        _, told = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert process.returncode == 128 + number, told
    assert "Traceback" not in told
    assert not list((folder / "tmp").iterdir())


@pytest.mark.parametrize("number", [INT, pytest.param(TERM, marks=pytest.mark.soak)])
def test_a_drive_that_is_ended_has_a_finished_bag(tmp_path: Path, number: signal.Signals) -> None:
    data = yaml.safe_load(EXAMPLE.read_text())
    data["backend"] = "analytic"
    data["assets"]["rocks"] = []
    data["materials"] = {"texture_size_px": 64, "mask": {"size_px": 64, "relief": 0}}
    data["sensors"]["cameras"][0] |= {"width_px": 32, "height_px": 24, "fx_px": 27, "fy_px": 27}
    data["sensors"]["lidars"][0]["scan"] |= {"azimuth_steps": 120}
    data["drive"] |= {"duration_s": 600.0}
    config = tmp_path / "drive.yaml"
    config.write_text(yaml.safe_dump(data))
    bag = tmp_path / "out" / "bag"
    process = begun(tmp_path, "oaisys_core", "drive", "--config", config, "--out", tmp_path / "out")
    wait_until(
        lambda: sum(file.stat().st_size for file in bag.glob("*.mcap")) > 200_000,
        START_PATIENCE_S,
        process=process,
    )
    end(process, tmp_path, number)
    assert "messages" in summary_of(bag)[0]
    reader = BagReader(bag)
    assert sum(1 for _ in reader.messages(list(reader.topics))) > 10
    assert not list((tmp_path / "out").rglob("*.part"))


@pytest.mark.soak
@pytest.mark.parametrize("number", [TERM, INT])
def test_a_gallery_that_is_ended_leaves_nothing(tmp_path: Path, number: signal.Signals) -> None:
    options = ("--out", tmp_path / "out", "--only", "stage_mo", "--backend", "analytic")
    process = begun(tmp_path, "tools.gallery", *options)
    wait_until(lambda: any((tmp_path / "out").glob("*.*")), START_PATIENCE_S, process=process)
    end(process, tmp_path, number)
