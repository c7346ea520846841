"""Long runs: what a process holds after many samples is what it held after few."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from repository import HELPERS


@pytest.mark.soak
def test_memory_stays_flat_over_samples() -> None:
    ended = subprocess.run(
        [sys.executable, str(HELPERS / "endurance.py"), "160"],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    found: dict[str, float] = json.loads(ended.stdout.splitlines()[-1])
    assert found["last_mb"] - found["half_mb"] < 10, found
    assert 0.9 < found["memory_ratio"] < 1.1, found
    assert found["files"] < 30
