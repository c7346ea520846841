"""A short soak; ``python -m tools.soak --samples 5000`` is the long one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from leak_check import LeakCheck
from repository import REPOSITORY

SAMPLES = int(os.environ.get("SOAK_SAMPLES", "60"))
PROCESSES = {"bridge", "mapper", "recorder", "server", "worker"}


@pytest.mark.soak
@pytest.mark.system
@pytest.mark.ros
def test_nothing_grows(tmp_path: Path, leaks: LeakCheck, ros_domain_id: int) -> None:
    command = [sys.executable, "-m", "tools.soak", "--samples", str(SAMPLES)]
    told = subprocess.run(
        [*command, "--size", "64x48", "--out", str(tmp_path)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=300 + 5 * SAMPLES,
        check=False,
    )

    logs = [f"{log.name}:\n{log.read_text()}" for log in sorted(tmp_path.glob("logs/*.log"))]
    assert told.returncode == 0, "\n".join([told.stdout, told.stderr, *logs])
    readings = json.loads((tmp_path / "soak.json").read_text())
    assert set(readings[str(SAMPLES)]) == PROCESSES
    for name, gauge in readings[str(SAMPLES)].items():
        assert gauge["descriptors"] > 0, name
        assert gauge["private_mb"] > 10, name
