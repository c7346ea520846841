"""A drive with lidar and IMU, from Python: every sensor at its own rate, in simulated time.

    python examples/08_drive.py [--seconds 0.5] [--out out/drive.png]

`oaisys drive` records a drive as files, bag and report. `Drive` does the same step by step:
`samples` yields images and scans in the order of their stamps, `imu_measurements` returns what an
IMU measures on the way, with its noise. A lidar's scan is not corrected for the rover's motion.
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np

from oaisys_core.config import adjust, load_config
from oaisys_core.drive.drive import Drive
from oaisys_core.simulation import Simulation

WORLD = Path(__file__).parents[1] / "config" / "examples" / "rover_drive.yaml"

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--seconds", type=float, default=0.5, help="of the drive, rendered")
parser.add_argument("--out", type=Path, default=Path("out/drive.png"), help="a picture")
options = parser.parse_args()
config = adjust(load_config(WORLD), backend="analytic", size="96x72")

with closing(Simulation(config)) as simulation:
    simulation.step_batch()
    drive = Drive(simulation, config)
    print(f"{drive.duration_s:.1f} s, {drive.sample_count()} stamps, rates: {drive.rates_hz} Hz")
    for timed in drive.samples():
        if timed.time_ns > 1e9 * options.seconds:
            break
        (x, y, z), scans = timed.sample.rig_pose.position_m, timed.sample.scans
        hits = sum(int(np.isfinite(scan.data["x"]).sum()) for scan in scans)
        print(f"{timed.time_ns / 1e9:.1f} s: at ({x:.2f}, {y:.2f}, {z:.2f}) m, {hits} lidar hits")
        timed.sample.save(options.out)
    imu = drive.imu_measurements("imu")
print("IMU:", imu)
