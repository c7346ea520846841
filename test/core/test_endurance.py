"""Long runs: what a process holds after many samples is what it held after few."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from blender_process import skip_without_blender
from repository import HELPERS


def figures(backend: str, samples: int) -> dict[str, float]:
    script = HELPERS / "endurance.py"
    ended = subprocess.run(
        [sys.executable, str(script), backend, str(samples)],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    return json.loads(ended.stdout.splitlines()[-1])


@pytest.mark.long
def test_memory_stays_flat_over_samples() -> None:
    found = figures("analytic", 160)
    assert found["last_mb"] - found["half_mb"] < 10, found
    assert 0.9 < found["memory_ratio"] < 1.1, found
    assert found["files"] < 30


@pytest.mark.long
@pytest.mark.blender
def test_memory_stays_flat_over_samples_in_blender() -> None:
    skip_without_blender()
    found = figures("blender", 60)
    assert found["last_mb"] - found["half_mb"] < 25, found
    assert 0.9 < found["memory_ratio"] < 1.1, found
    assert found["files"] < 40
