"""A lunar place over a day: the same view while the sun goes round, low above a crater's rim.

    python examples/10_lunar_day.py [--hours 8 12 16] [--out out/lunar_day.png]

A view's metadata can move the sun. At latitude f, with the sun above the equator, its elevation h
follows sin h = cos f cos H; the hour angle H is 0 at noon. An hour is 1/24 of the Moon's day.
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--hours", type=float, nargs="+", default=[8, 10, 12, 14, 16], help="of a day")
parser.add_argument("--out", type=Path, default=Path("out/lunar_day.png"), help="a picture")
options = parser.parse_args()
camera = {"width_px": 240, "height_px": 160, "fx_px": 200, "fy_px": 200, "modalities": ["rgb"]}
world = {
    "backend": "analytic",  # "blender" for path-traced light between the rocks
    "stage": {"preset": "craters", "extent_m": 60, "body": "moon", "relief_m": 4},
    "materials": {"layers": [{"texture": "regolith", "label": "regolith", "semantic_id": 1}]},
    "assets": {"rock_texture": "basalt", "rocks": [{"kind": "angular", "count": [150, 150]}]},
    "environment": {"sky": {"model": "none"}, "sun_strength_w_m2": 5.0},
    "sensors": {"cameras": [camera]},
}
pose, latitude, strip = pose_looking_at((-14, -10, 9), (2, 2, 0)), np.radians(60), []
with closing(Simulation(config_from_mapping(world))) as simulation:
    simulation.step_batch(seed=3)
    for hour in options.hours:
        angle = np.radians(15 * (hour - 12))
        up, north = np.array([np.cos(latitude), -np.sin(latitude)]) * np.cos(angle)
        elevation_deg, azimuth_deg = np.degrees([np.arcsin(up), np.arctan2(north, -np.sin(angle))])
        sun = {"sun_elevation_deg": elevation_deg.item(), "sun_azimuth_deg": azimuth_deg.item()}
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}, environment=sun))
        strip.append(sample.frames[0].data)
        print(f"{hour:g} h: sun {elevation_deg:.1f}° up, mean level {strip[-1].mean():.0f}")
options.out.parent.mkdir(parents=True, exist_ok=True)
Image.fromarray(np.hstack(strip)).save(options.out)
