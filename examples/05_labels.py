"""Labels and their legend: what each pixel shows, as a class and as a single thing.

    python examples/05_labels.py [WORLD.yaml] [--out out/labels.png]

`semantic_0` holds a class id for each pixel (uint16; 0 is unlabelled), `instance` the id of a
thing (uint32; 0 is none). Both come from a ray through the pixel's centre, so no pixel mixes two
ids. The legend, `SimulatorInfo.semantic_labels`, names the classes of this world; in ROS it is
latched on `camera/semantic_0/labels`. `list_objects` names the things.
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np

from oaisys_core.config import SimulationConfig, load_config
from oaisys_core.geometry import pose_looking_at
from oaisys_core.simulation import Simulation
from oaisys_core.types import INSTANCE, SEMANTIC_0, ModuleMetadata, ObjectQuery

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("world", nargs="?", type=Path, help="the default: that of `make demo`")
parser.add_argument("--out", type=Path, default=Path("out/labels.png"), help="a picture")
options = parser.parse_args()
config = load_config(options.world) if options.world else SimulationConfig()
metadata = ModuleMetadata(sensor={"pose": pose_looking_at((-6, 0, 5), (0, 0, 0))})

with closing(Simulation(config)) as simulation:
    simulation.step_batch(seed=7)
    sample = simulation.step_sample(metadata, modalities=(SEMANTIC_0, INSTANCE))
    legend = simulation.info().semantic_labels
    things = simulation.list_objects(ObjectQuery(limit=5000)).objects

camera = sample.frames[0].sensor
labels = sample.frame(camera, SEMANTIC_0).data
for semantic_id, pixels in zip(*np.unique(labels, return_counts=True), strict=True):
    print(f"{legend.get(int(semantic_id), 'unlabelled')}: {pixels / labels.size:.1%}")
names = {thing.instance_id: thing.name for thing in things}
seen = set(names) & set(np.unique(sample.frame(camera, INSTANCE).data).tolist())
print(f"{len(seen)} of {len(things)} things are in view: {', '.join(names[i] for i in seen)}")
print("picture:", sample.save(options.out))
