"""Next best view of your own: a planner that looks at the hill from where most is new, without ROS.

    python examples/09_next_best_view.py [--views 6] [--out out/exploration.png]

A `Situation` is the map of observations, the vehicle and the views so far. Its `gains` scores views
by the surface that they would add, and its `roadmap` knows paths through space known to be free.
As a `Planner`, the same lines compete with others in `oaisys explore` (docs/exploration.md).
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np

from oaisys_core.config import config_from_mapping
from oaisys_core.geometry import pose_to_matrix
from oaisys_core.simulation import Simulation
from oaisys_core.types import DEPTH, ModuleMetadata
from oaisys_mapping.exploration.occupancy_map import Bounds, OccupancyMap
from oaisys_mapping.exploration.planner import Situation, Vehicle, level_pose

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--views", type=int, default=6, help="how many it may take")
parser.add_argument("--out", type=Path, default=Path("out/exploration.png"), help="a picture")
options = parser.parse_args()
world = {"backend": "analytic", "stage": {"preset": "mountain_1", "extent_m": 40}}
world |= {"sensors": {"cameras": [{"width_px": 96, "height_px": 72, "fx_px": 60, "fy_px": 60}]}}
seen = OccupancyMap(Bounds(np.array((-18.0, -18, -2)), np.array((18.0, 18, 14))), voxel_size_m=0.5)
rng, visited = np.random.default_rng(1), [level_pose((-12, 0, 8), 0.0)]
seen.set_free(visited[0].position_m, radius_m=2.5)

with closing(Simulation(config_from_mapping(world))) as simulation:
    simulation.step_batch(seed=7)
    for number in range(1, options.views + 1):
        sample = simulation.step_sample(ModuleMetadata(sensor={"pose": visited[-1]}))
        frame = next(frame for frame in sample.frames if frame.modality == DEPTH)
        seen.integrate(frame.data, frame.intrinsics, frame.T_map_camera, max_range_m=20.0)
        sample.save(options.out)
        print(f"view {number}: {(seen.quality > 0).sum()} voxels of surface")
        T_base_camera = np.linalg.inv(pose_to_matrix(visited[-1])) @ frame.T_map_camera
        now = Situation(Vehicle(frame.intrinsics, T_base_camera), seen, visited, rng)
        places_m = now.random_positions(60)
        reachable = np.isfinite(now.roadmap(places_m).lengths_m)
        poses = [level_pose(p, np.arctan2(-p[1], -p[0])) for p in places_m]  # towards the hill
        visited.append(poses[int(np.where(reachable, now.gains(poses), -1).argmax())])
