"""Light on the bottom of water, in Cycles, against Fresnel's law."""

from __future__ import annotations

from dataclasses import replace
from math import asin, radians, sin, tan

import numpy as np
import pytest
from blender_process import in_blender
from synthetic_worlds import CENTRED, SUNNY, camera, flat_world

from oaisys_core.geometry import pose_looking_down
from oaisys_core.procedural.terrain.water.ponds import WaterLook, water_mesh
from oaisys_core.scene import Placement

INDEX = 1.33


def mirrored(angle_deg: float) -> float:
    """Fresnel's share of light that is not polarised, by its angle from the vertical."""
    if not angle_deg:
        return ((INDEX - 1) / (INDEX + 1)) ** 2
    i = radians(angle_deg)
    t = asin(sin(i) / INDEX)
    across, along = sin(i - t) / sin(i + t), tan(i - t) / tan(i + t)
    return (across**2 + along**2) / 2


@pytest.mark.blender
@pytest.mark.parametrize("elevation_deg", [15.0, pytest.param(35.0, marks=pytest.mark.soak), 60.0])
def test_the_sun_lights_the_bottom_of_shallow_water(elevation_deg: float) -> None:
    """It was black below 41 degrees: light from below was reflected in full, as in glass."""
    sun = replace(
        SUNNY, model="none", sun_elevation_rad=radians(elevation_deg), sun_strength_w_m2=4.0
    )
    dry = replace(flat_world(), primitives=(), sky=sun)
    corners_m = np.array([(-9.0, -9, 0.4), (9, -9, 0.4), (9, 9, 0.4), (-9, 9, 0.4)])
    look = WaterLook(1.0, (0.1, 0.2, 0.2), 0.0)
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    sheet = water_mesh("water", corners_m, triangles, np.zeros(4), look)
    surface = Placement(0, (40,), np.eye(4)[None], np.array([65_001], np.uint32))
    under = replace(dry, prototypes=(sheet,), placements=(surface,))
    # Ten metres above, a pixel in the middle looks straight down.
    view = camera(pose_looking_down(0.0, 0.0, 10.0), replace(CENTRED, fx_px=400.0, fy_px=400.0))
    seen = [
        in_blender("environment.linear_views", each, [view], [sun], 64)[0] for each in (dry, under)
    ]
    share = float((seen[1].mean(axis=(0, 1)) / seen[0].mean(axis=(0, 1))).mean())
    expected = (1 - mirrored(90.0 - elevation_deg)) * (1 - mirrored(0.0))
    assert share == pytest.approx(expected, rel=0.03)
    assert seen[0].mean() > 0.05
    assert seen[0].max() < 1, "something is overexposed"
