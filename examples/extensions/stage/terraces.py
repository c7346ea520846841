"""A stage of terraces that rise from south to north."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oaisys_core.procedural.terrain.landform import GroundSpec

STEPS = 6


def terraces(spec: GroundSpec, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return (resolution_px, resolution_px) heights in metres; row i lies at the i-th y."""
    relief_m = 6.0 if spec.relief_m is None else spec.relief_m
    y = np.linspace(0.0, STEPS, spec.resolution_px)
    x = np.linspace(0.0, 2 * np.pi, spec.resolution_px)
    bend = 0.3 * np.sin(x + rng.uniform(0, 2 * np.pi))
    level = y[:, None] + bend[None, :]
    steep = np.clip((level % 1.0 - 0.8) / 0.2, 0.0, 1.0)
    height = (np.floor(level) + steep) / STEPS * relief_m
    rough = rng.normal(0.0, 0.01 * spec.roughness, height.shape)
    return (height - np.median(height) + rough).astype(np.float32)
