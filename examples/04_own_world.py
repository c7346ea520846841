"""A world of your own: heights from numpy, two textures, boulders, a low sun, a stereo pair.

    python examples/04_own_world.py [BACKEND]

A configuration is a mapping, the same as in YAML. A key that is not given keeps its default; an
unknown key is refused with its path. docs/configuration.md lists all keys, config/examples/ has a
small file for each thing they can do. BACKEND is `analytic` (the default here) or `blender`.
"""

import sys
from contextlib import closing

import numpy as np
from PIL import Image

from oaisys_core.config import config_from_mapping
from oaisys_core.simulation import Simulation

y, x = np.mgrid[0:129, 0:129] / 128  # row 0 is in the north
height_m = 2 + np.sin(6 * x) + np.cos(9 * y)
Image.fromarray((1000 * height_m).astype(np.uint16)).save("heights.png")  # millimetres

sand = {"texture": "sand", "label": "sand", "semantic_id": 1}
gravel = {"texture": "gravel", "label": "gravel", "semantic_id": 2}
world = {
    "backend": sys.argv[1] if sys.argv[1:] else "analytic",
    "stage": {"dem": {"file": "heights.png", "spacing_m": 0.25, "scale": 0.001, "offset_m": 0}},
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
print("images:", ", ".join(f"{frame.sensor} {frame.modality}" for frame in sample.frames))
