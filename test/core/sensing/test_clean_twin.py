"""Noisy and true distances side by side in one sample, of pinholes, lenses and fisheyes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation
from oaisys_core.types import Sample

NOISE = {"seed": 9, "depth_noise": "quadratic", "depth_sigma_m": 0.05, "missing_ratio": 0.1}
SIZE: dict[str, Any] = {"width_px": 24, "height_px": 18, "fx_px": 20.0, "fy_px": 20.0}
CAMERAS = [
    {**SIZE, "name": "pinhole"},
    {**SIZE, "name": "lens", "distortion": {"k1": -0.2}},
    {**SIZE, "name": "fisheye", "fisheye": {"k1": 0.01}, "fx_px": 10.0, "fy_px": 10.0},
]


def sample_of(modalities: list[str], faults: dict[str, Any]) -> Sample:
    cameras = [{**camera, "modalities": modalities} for camera in CAMERAS]
    data = {
        "backend": "analytic",
        "stage": {"surroundings": "plain", "extent_m": 30.0, "resolution_px": 33},
        "materials": {"texture_size_px": 32, "mask": {"size_px": 32, "relief": 0}},
        "assets": {"rocks": []},
        "sensors": {"cameras": cameras, "faults": faults},
    }
    simulation = Simulation(config_from_mapping(data))
    simulation.step_batch(seed=5)
    sample = simulation.step_sample()
    simulation.close()
    return sample


@pytest.mark.parametrize("name", ["depth", "range"])
def test_the_twin_is_what_a_sensor_without_faults_measures(name: str) -> None:
    noisy = sample_of(["depth", "range", f"{name}_true"], NOISE)
    clean = sample_of(["depth", "range"], {})
    for camera in CAMERAS:
        twin = noisy.frame(camera["name"], f"{name}_true")
        assert twin.data.dtype == np.float32
        assert twin.data.tobytes() == clean.frame(camera["name"], name).data.tobytes()
        measured = noisy.frame(camera["name"], name).data
        hit = np.isfinite(twin.data)
        assert (measured[hit] != twin.data[hit]).mean() > 0.5
        assert np.isnan(measured).any()
        assert not np.isnan(twin.data).any()


def test_the_twin_changes_no_other_image() -> None:
    alone = sample_of(["depth", "range"], NOISE)
    with_twins = sample_of(["depth", "range", "depth_true", "range_true"], NOISE)
    for frame in alone.frames:
        other = with_twins.frame(frame.sensor, frame.modality)
        assert frame.data.tobytes() == other.data.tobytes()


def test_twins_are_equal_without_faults() -> None:
    sample = sample_of(["depth", "range", "depth_true", "range_true"], {})
    for camera in CAMERAS:
        for name in ("depth", "range"):
            frames = (sample.frame(camera["name"], each) for each in (name, f"{name}_true"))
            one, other = (frame.data.tobytes() for frame in frames)
            assert one == other
