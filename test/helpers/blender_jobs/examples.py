"""What the tests of the examples do inside Blender."""

from __future__ import annotations

from pathlib import Path
from typing import Any

# Comes before anything that loads Open3D.
import bpy  # noqa: F401
from coarse_clouds import coarse_clouds

from oaisys_core.config import SimulationConfig, adjust, load_config
from oaisys_core.simulation import Simulation

MAX_GRID_PX = 129
MIN_GRID_PX = 65
"""Where the ground is not what the example is about."""
MAX_ROCKS = 15
MAX_THINGS = 3000
"""Of a group: those of `assets_pebbles` are in view, of which there are 100,000 without it."""
MAX_VARIANTS = 1


def rendered(paths: list[str], samples: int, backend: str = "blender") -> dict[str, dict[str, Any]]:
    """Render the first samples of each configuration, its images 48 pixels long."""
    configs = {Path(path).stem: load_config(Path(path)) for path in paths}
    # Only then the backend: afterwards nobody knows any more what a file has given.
    small_ones = {name: adjust(_on_plain(each), backend=backend) for name, each in configs.items()}
    with coarse_clouds():
        return {name: _rendered(each, samples) for name, each in small_ones.items()}


def _on_plain(config: SimulationConfig) -> SimulationConfig:
    """Return the configuration, small, and without land unless its file speaks of it."""
    data = small(config).model_dump()
    if "surroundings" not in config.stage.model_fields_set:
        data["stage"]["surroundings"] = "plain"
    return SimulationConfig.model_validate(data)


def small(config: SimulationConfig) -> SimulationConfig:
    """Return the configuration, small: ground, rocks and groups, images and samples per pixel.

    Sections that its file does not have are smaller still: other files are about them.
    """
    given = config.model_fields_set
    data = adjust(config, size="48x36", quality="preview").model_dump()
    data["stage"]["resolution_px"] = min(config.stage.resolution_px, MAX_GRID_PX)
    data["materials"]["texture_size_px"] = 64
    data["materials"]["mask"]["size_px"] = min(config.materials.mask.size_px, 128)
    for rocks in data["assets"]["rocks"]:
        rocks["count"] = [min(count, MAX_ROCKS) for count in rocks["count"]]
        rocks["variants"] = min(rocks["variants"], MAX_VARIANTS)
    for group in data["assets"]["groups"]:
        group["count"] = [min(count, MAX_THINGS) for count in group["count"]]
        if group["shape"] is not None:
            group["variants"] = min(group["variants"] or MAX_VARIANTS, MAX_VARIANTS)
    if "stage" not in given:
        data["stage"] |= {"resolution_px": MIN_GRID_PX, "surroundings": "plain"}
    if "materials" not in given:
        data["materials"]["layers"] = data["materials"]["layers"][:1]
    if "assets" not in given:
        data["assets"]["rocks"] = data["assets"]["rocks"][:1]
    return SimulationConfig.model_validate(data)


def _rendered(config: SimulationConfig, samples: int) -> dict[str, Any]:
    simulation = Simulation(config)
    try:
        simulation.step_batch()
        taken = [simulation.step_sample() for _ in range(samples)]
        labels = sorted(simulation.info().semantic_labels)
    finally:
        simulation.close()
    frames = [[(f.sensor, f.modality, f.data) for f in sample.frames] for sample in taken]
    scans = [[(s.sensor, s.data, s.T_map_lidar) for s in sample.scans] for sample in taken]
    return {"samples": frames, "scans": scans, "labels": labels}
