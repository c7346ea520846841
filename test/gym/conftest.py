"""Fixtures of the gym's tests: one small simulator a file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from oaisys_gym.simulator import EpisodeSimulator

SMALL_WORLD: dict[str, Any] = {
    "backend": "analytic",
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 24, "resolution_px": 33},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 64}},
    "assets": {"rocks": [{"count": [5, 5]}]},
    "sensors": {"cameras": [{"width_px": 64, "height_px": 48, "fx_px": 54.114, "fy_px": 54.114}]},
    "render": {"quality": "draft"},
}

FAULTS = {"missing_ratio": np.float32(0.3), "depth_noise": "kinect", "min_depth_m": 4.0}
"""The share is a number of NumPy, as of a sweep over configurations."""


@pytest.fixture(scope="module")
def own() -> Iterator[EpisodeSimulator]:
    """A simulator that was started as an environment starts one."""
    simulator = EpisodeSimulator(SMALL_WORLD, "")
    yield simulator
    simulator.close()


@pytest.fixture(scope="module")
def faulty() -> Iterator[EpisodeSimulator]:
    """A simulator whose sensor has faults, and whose light is drawn for each sample."""
    sensors = SMALL_WORLD["sensors"] | {"faults": FAULTS}
    light = {"sun_elevation_deg": (10, 80), "redraw": "sample"}
    simulator = EpisodeSimulator(SMALL_WORLD | {"sensors": sensors, "environment": light}, "")
    yield simulator
    simulator.close()
