"""Colour lies on depth, or is refused, however far a camera is from the origin of ``map``."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

pytestmark = pytest.mark.blender

FOCAL_PX = 300.0
FAR_M = (1e3, 1e5, 2e5)


def test_colour_far_from_the_origin_lies_on_depth_or_is_refused() -> None:
    """Poles 20 cm wide, seen from 8 m; 2e5 m is where 16 mm are half a pixel."""
    poles = [
        {"shape": "box", "size_m": [0.2, 0.2, 6], "position_m": [x, 0, 0], "color_srgb": [1, 0, 0]}
        for x in FAR_M
    ]
    view = {"width_px": 64, "height_px": 48, "fx_px": FOCAL_PX, "fy_px": FOCAL_PX}
    camera = {"name": "camera", **view, "modalities": ["rgb", "semantic_0"]}
    config = {
        "stage": {"preset": "plane", "extent_m": 1000, "resolution_px": 9, "surroundings": "plain"},
        "assets": {"rocks": [], "primitives": poles},
        "sensors": {"pose_policy": "allow", "cameras": [camera]},
        "environment": {"sun_elevation_deg": 40, "sun_azimuth_deg": 180},
        "render": {"quality": "preview"},
    }
    simulation = Simulation(config_from_mapping(config))
    simulation.step_batch(ModuleMetadata())
    for x, beside_m in zip(FAR_M, (0.02, -0.03, 0.01), strict=True):
        pose = pose_looking_at((x - 8, beside_m, 1.5), (x, beside_m, 1.5))
        step = ModuleMetadata(sensor={"pose": pose})
        if x == FAR_M[-1]:
            # Beside it, numpy's spacing is 1/64 m: 300 px / 64 / 7.9 m = 0.59 px.
            told = r"origin of map.*0\.016 m apart.*7\.9 m away.*0\.59 pixels"
            with pytest.raises(InvalidInputError, match=told):
                simulation.step_sample(step)
            away = pose_looking_at((x - 8, 0, 1.5), (x - 100, 0, 60))
            simulation.step_sample(ModuleMetadata(sensor={"pose": away}))  # only the sky
            continue
        rgb = {frame.modality: frame for frame in simulation.step_sample(step).frames}["rgb"]
        red = np.clip(rgb.data[..., 0].astype(float) - rgb.data[..., 2], 0, None)
        is_pole = red > np.percentile(red, 98) / 2
        seen_px = np.nonzero(is_pole)[1].mean()
        assert seen_px == pytest.approx(31.5 + FOCAL_PX * beside_m / 7.9, abs=0.5)
