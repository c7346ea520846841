"""Your rover's URDF and your camera's calibration: their sensors, in a world.

    python examples/11_robot.py [ROBOT.urdf] [--calibration FILE] [--out out/robot.png]

`oaisys sensors import FILE` writes the section `sensors` of a configuration; this is the same from
Python. A robot's file gives poses, sizes and rates of its sensors; a calibration (ROS, Kalibr,
EuRoC, OpenCV, COLMAP, nerfstudio) gives intrinsics and distortion. Notes name all that is not used.
"""

import argparse
from contextlib import closing
from pathlib import Path

from oaisys_core.config import config_from_mapping
from oaisys_core.files.calibrations import read_calibration
from oaisys_core.files.calibrations.reading import read_robot_file
from oaisys_core.geometry import pose_looking_at
from oaisys_core.importing.robots import robot_sections, sensors_section
from oaisys_core.simulation import Simulation
from oaisys_core.types import ModuleMetadata

ROVER = Path(__file__).parents[1] / "config" / "examples" / "assets" / "rover.urdf"

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("robot", nargs="?", type=Path, default=ROVER, help="URDF or SDF")
parser.add_argument("--calibration", type=Path, help="replaces the robot's cameras")
parser.add_argument("--out", type=Path, default=Path("out/robot.png"), help="a picture")
options = parser.parse_args()

robot = read_robot_file(options.robot)
assert robot is not None, f"{options.robot} is no robot: use --calibration"
sections, notes = robot_sections(robot, options.robot, None)
if options.calibration:
    sections["sensors"] |= sensors_section(read_calibration(options.calibration))
print(*notes, sep="\n")
world = {"backend": "analytic", "stage": {"extent_m": 30}, "materials": {"texture_size_px": 64}}
with closing(Simulation(config_from_mapping(world | sections))) as simulation:
    simulation.step_batch(seed=7)
    height_m = simulation.query_height([(0, 0, 0)]).ground_height_m[0]
    pose = pose_looking_at((0, 0, height_m + 0.3), (5, 0, height_m + 0.3))
    sample = simulation.step_sample(ModuleMetadata(sensor={"pose": pose}))
for frame in sample.frames:
    height_px, width_px = frame.data.shape[:2]
    print(f"{frame.sensor} {frame.modality}: {width_px}x{height_px}, K {frame.intrinsics.K[0]}")
print("scans:", *(f"{scan.sensor} {scan.data.shape}" for scan in sample.scans))
print("picture:", sample.save(options.out))
