"""Many samples in one process: ``python endurance.py SAMPLES``; prints figures as JSON."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

AROUND = [
    pose_looking_at((0, 0, 8), (x_m, y_m, 0))
    for x_m, y_m in ((100, 0), (0, 100), (-100, 0), (0, -100))
]
"""Views of all of the world: tables of what is far away are made when it is first seen."""
PAGE = os.sysconf("SC_PAGE_SIZE")


def config(backend: str) -> dict[str, Any]:
    """A world in which everything changes from sample to sample."""
    return {
        "backend": backend,
        "stage": {
            "extent_m": 30.0,
            "resolution_px": 129,
            "detail": {"radius_m": 2.0, "spacing_m": 0.05},
        },
        "materials": {"texture_size_px": 64, "mask": {"size_px": 64}},
        "assets": {
            "rocks": [{"count": [60, 60]}],
            "movers": [
                {
                    "name": "rover",
                    "shape": "rover",
                    "label": "rover",
                    "semantic_id": 30,
                    "trajectory": {"waypoints_m": [[-8, -8], [8, 6], [2, 9]], "step_m": 0.1},
                }
            ],
        },
        "environment": {"sun_azimuth_deg": [0, 360], "redraw": "sample"},
        "sensors": {
            "cameras": [
                {
                    "name": "camera",
                    "width_px": 64,
                    "height_px": 48,
                    "fx_px": 50,
                    "fy_px": 50,
                    "modalities": ["rgb", "depth", "semantic_0", "instance", "normal", "flow"],
                }
            ],
            "motion": {"kind": "hover", "height_above_ground_m": 2.0},
        },
        "render": {"quality": "preview"},
    }


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def main(samples: int) -> None:
    simulation = Simulation(config_from_mapping(config("analytic")))
    simulation.step_batch()
    for pose in AROUND:
        simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
    memory = []
    for index in range(samples):
        edits = {"objects": {"1": {"hidden": index % 2 == 0}}}
        simulation.step_sample(ModuleMetadata(asset=edits))
        memory.append(resident_bytes())
    simulation.close()
    tenth = samples // 10
    # As the promise has it for 500 samples: 50 to 150, and the last 100.
    early, late = slice(tenth, 3 * tenth), slice(samples - 2 * tenth, samples)
    figures = {
        "half_mb": memory[samples // 2] / 1e6,
        "last_mb": memory[-1] / 1e6,
        "memory_ratio": float(np.mean(memory[late]) / np.mean(memory[early])),
        "files": len(list(Path("/proc/self/fd").iterdir())),
    }
    sys.stdout.write(json.dumps(figures) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]))
