"""A stage of another package that cannot be made from some seeds."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oaisys_core.errors import RenderError
from oaisys_core.procedural.terrain.landform import GroundSpec

FRAGILE_SEEDS = "3,2"
"""Of the first there is no world, of the second there is."""


def fragile(spec: GroundSpec, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return (resolution_px, resolution_px) heights in metres, or raise by chance."""
    if rng.random() < 0.5:
        raise RenderError("the ground has slid away")
    x = np.linspace(0.0, 2 * np.pi, spec.resolution_px)
    return np.asarray(np.sin(x)[:, None] * np.cos(x)[None, :], np.float32)


def install_fragile_stage(folder: Path) -> dict[str, str]:
    """Return the variables with which a process finds the stage by the name ``fragile``."""
    package = folder / "fragile_stage-1.dist-info"
    package.mkdir(parents=True)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: fragile-stage\nVersion: 1\n")
    points = f"[oaisys.stages]\nfragile = {__name__}:{fragile.__name__}\n"
    (package / "entry_points.txt").write_text(points)
    folders = (str(folder), str(Path(__file__).parent), os.environ.get("PYTHONPATH", ""))
    return {"PYTHONPATH": os.pathsep.join(filter(None, folders))}
