"""``oaisys explore`` in a small world, as a user runs it, and processes of an experiment."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import psutil

WORLD = """
seed: 4
stage: {surroundings: plain, preset: mountain_1, extent_m: 24, resolution_px: 193}
materials: {texture_size_px: 64, mask: {size_px: 128}}
assets: {rocks: [{count: [20, 20], size_m: [0.3, 1.0]}]}
"""

COARSE = ("--voxel-size", "0.3", "--quality", "geometry")
"""For runs whose map and colours are not looked at."""


def run(
    out: Path, world: Path, domain_id: int, *more: str, variables: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Return how it ended."""
    options = ("--config", str(world), "--out", str(out), "--backend", "analytic", *more)
    return subprocess.run(
        [sys.executable, "-m", "oaisys_core", "explore", *options],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain_id), **(variables or {})},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def recorder_of(experiment: subprocess.Popen[bytes]) -> psutil.Process:
    """Return the process of an experiment's recorder."""
    (recorder,) = (
        child
        for child in psutil.Process(experiment.pid).children(recursive=True)
        if "oaisys_ros_bridge.nodes.recorder" in child.cmdline()
    )
    return recorder
