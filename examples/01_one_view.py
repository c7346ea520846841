"""One view in this process: no server, no ROS.

    python examples/01_one_view.py [WORLD.yaml] [--out out/one_view.png]

`Simulation` has two verbs. `step_batch` draws a new world from a seed; `step_sample` moves the
rig, renders, and returns a `Sample`: one `Frame` for each camera and modality. Depth is planar z
in metres, float32, +inf where nothing was hit. Without a WORLD.yaml it is the world of `make demo`,
rendered by Blender; a world with `backend: analytic` needs no Blender and takes milliseconds.
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image

from oaisys_core.config import SimulationConfig, load_config
from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("world", nargs="?", type=Path, help="the default: that of `make demo`")
parser.add_argument("--out", type=Path, default=Path("out/one_view.png"), help="a picture")
options = parser.parse_args()
config = load_config(options.world) if options.world else SimulationConfig()
pose = pose_looking_at(eye_m=(-8, -6, 6), target_m=(0, 0, 0))  # in `map`: z up, metres

with closing(Simulation(config)) as simulation:
    simulation.step_batch(seed=7)
    sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))

for frame in sample.frames:
    print(f"{frame.sensor} {frame.modality}: {frame.data.dtype} {frame.data.shape}")
camera = sample.frames[0].sensor
depth_m = sample.frame(camera, "depth").data
print(f"nearest {depth_m.min():.2f} m, sky {np.isinf(depth_m).mean():.0%} of the image")
options.out.parent.mkdir(parents=True, exist_ok=True)
Image.fromarray(sample.frame(camera, "rgb").data).save(options.out)
