"""KISS-ICP on the lidar of a recorded drive, against the true motion."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from oaisys_mapping.odometry.programs import ProgramError, program, program_folder, run_program
from oaisys_mapping.odometry.trajectories import (
    TimedTransforms,
    ape_rmse,
    drift_share,
    time_offset_s,
)

KISS_ICP = "kiss_icp_pipeline"


@dataclass(frozen=True)
class LidarOdometryFigures:
    """How well KISS-ICP follows a lidar.

    Attributes:
        scans: Number of scans.
        way_m: Length of the lidar's true way.
        drift_share: Mean relative error of evo's RPE, as a share of the way; see `drift_share`.
        ape_rmse_m: evo's APE after the first poses were made equal.
        time_offset_s: By how much the scans' stamps are late, from the turns of the lidar.
    """

    scans: int
    way_m: float
    drift_share: float
    ape_rmse_m: float
    time_offset_s: float


def kiss_icp(bag: Path, topic: str, *, max_range_m: float, deskew: bool = True) -> TimedTransforms:
    """Return the poses of a lidar, relative to its first, as KISS-ICP finds them.

    Args:
        bag: Folder of the bag.
        topic: Topic of the lidar.
        max_range_m: Farther points are ignored; the voxels are a hundredth of it.
        deskew: Whether points are corrected for the motion during the scan, by their times.

    Raises:
        ProgramError: KISS-ICP is not installed, or fails.
    """
    executable = program(KISS_ICP)
    if executable is None:
        raise ProgramError(f"{KISS_ICP} is not installed")
    with program_folder() as home:
        variables = {
            "kiss_icp_out_dir": str(home / "results"),
            "kiss_icp_data": json.dumps({"max_range": max_range_m, "deskew": deskew}),
        }
        arguments = ["--dataloader", "rosbag", "--topic", topic, str(bag.absolute())]
        run_program([executable, *arguments], home, variables)
        results = home / "results" / "latest"
        (poses,), (tum,) = results.glob("*_poses.npy"), results.glob("*_poses_tum.txt")
        times_s = np.loadtxt(tum, ndmin=2)[:, 0]
        return TimedTransforms(times_s, np.load(poses))


def judge(
    estimate: TimedTransforms, truth: TimedTransforms, T_base_lidar: ArrayLike, scan_s: float
) -> LidarOdometryFigures:
    """Return how well an estimate of KISS-ICP agrees with the truth.

    Args:
        estimate: Poses by the stamps of the scans.
        truth: Poses of ``base_link``.
        T_base_lidar: (4, 4) mount of the lidar.
        scan_s: Time from the stamp to the moment for which a pose holds.

    Raises:
        ProgramError: evo is not installed, or fails.
    """
    true_lidar = truth.mount(T_base_lidar)
    late_s = time_offset_s(estimate.delay(scan_s), true_lidar)
    times_s = estimate.times_s + scan_s
    known = (times_s >= truth.times_s[0]) & (times_s <= truth.times_s[-1])
    found = TimedTransforms(times_s[known], estimate.T[known])
    reference = true_lidar.at(found.times_s)
    with program_folder() as folder:
        reference_file, estimate_file = folder / "truth.tum", folder / "estimate.tum"
        reference.write_tum(reference_file)
        found.write_tum(estimate_file)
        way_m = reference.way_m()
        return LidarOdometryFigures(
            scans=len(found.times_s),
            way_m=way_m,
            drift_share=drift_share(reference_file, estimate_file, way_m),
            ape_rmse_m=ape_rmse(reference_file, estimate_file, aligned=True),
            time_offset_s=late_s,
        )
