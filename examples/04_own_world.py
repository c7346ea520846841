"""A world of your own: heights from numpy, two textures, boulders, a low sun, a stereo pair.

    python examples/04_own_world.py [analytic|blender] [--out out/own_world.png]

A configuration is a mapping, the same as in YAML: docs/configuration.md lists all keys,
config/examples/ has a small file for each. Heights are left in out/heights.png.
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("backend", nargs="?", choices=["analytic", "blender"], default="analytic")
parser.add_argument("--out", type=Path, default=Path("out/own_world.png"), help="a picture")
options = parser.parse_args()

y, x = np.mgrid[0:129, 0:129] / 128  # row 0 is in the north
height_m = 2 + np.sin(6 * x) + np.cos(9 * y)
(heights := Path("out/heights.png")).parent.mkdir(exist_ok=True)
Image.fromarray((1000 * height_m).astype(np.uint16)).save(heights)  # millimetres

sand = {"texture": "sand", "label": "sand", "semantic_id": 1}
gravel = {"texture": "gravel", "label": "gravel", "semantic_id": 2}
world = {
    "backend": options.backend,
    "stage": {"dem": {"file": str(heights), "spacing_m": 0.25, "scale": 0.001, "offset_m": 0}},
    "materials": {"layers": [sand, gravel]},
    "assets": {"rocks": [{"kind": "boulder", "count": [12, 12], "size_m": [0.5, 1.5]}]},
    "environment": {"sun_elevation_deg": 12},
    "sensors": {"stereo": [{"baseline_m": 0.12}]},
}
with closing(Simulation(config_from_mapping(world))) as simulation:
    simulation.step_batch(seed=11)
    ground_m = simulation.query_height([(0, 0, 0), (5, 5, 0)]).ground_height_m
    sample = simulation.step_sample()
print("ground:", ground_m.round(2), "m, given:", height_m[64, 64].round(2), "m in the middle")
print("images:", *(f"{frame.sensor} {frame.modality}" for frame in sample.frames))
print("picture:", sample.save(options.out))
