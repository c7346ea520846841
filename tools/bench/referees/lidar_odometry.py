"""KISS-ICP on the scans of a drive, in a process of its own.

``python -m tools.bench.referees.lidar_odometry FOLDER MODE`` writes its poses. The folder has the
scans, see `write_scans`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from oaisys_core.types import FloatArray
from oaisys_mapping.odometry.trajectories import TimedTransforms
from tools.bench.referees.module_process import run_module

Mode = Literal["true_motion", "own_motion", "no_times"]
"""How points are corrected for the motion during a scan: before KISS-ICP sees them, with the true
motion; by KISS-ICP, with that of the scan before and their times; not at all."""
MODES: tuple[Mode, ...] = get_args(Mode)

STAMPS = "stamps.npy"
SCANS = "scan_*.npz"


@dataclass(frozen=True)
class TimedScan:
    """One scan.

    Attributes:
        stamp_s: When it began.
        points_m: (N, 3) points in the lidar's frame, each at its own time.
        moved_m: (N, 3) the same in the lidar's true frame at the end of the scan.
        share: (N,) time of each point as a share of the scan, 0 at its begin and 1 at its end.
    """

    stamp_s: float
    points_m: FloatArray
    moved_m: FloatArray
    share: FloatArray


def write_scans(folder: Path, scans: Iterable[TimedScan]) -> None:
    """Write scans for `odometry`, one after the other."""
    folder.mkdir(parents=True, exist_ok=True)
    stamps_s = []
    for i, scan in enumerate(scans):
        points = {"points_m": scan.points_m, "moved_m": scan.moved_m, "share": scan.share}
        file = folder / SCANS.replace("*", f"{i:06d}")
        np.savez(file, **{name: np.asarray(each, np.float32) for name, each in points.items()})
        stamps_s.append(scan.stamp_s)
    np.save(folder / STAMPS, np.array(stamps_s))


def odometry(folder: Path, mode: Mode, scan_s: float) -> TimedTransforms:
    """Return the lidar's poses as KISS-ICP finds them, at the times for which they hold.

    Args:
        folder: Written by `write_scans`.
        mode: How points are corrected for the motion.
        scan_s: How long a scan takes. With uncorrected points, a pose holds on the average for
            the middle of its scan, otherwise for the end.

    Raises:
        ProgramError: KISS-ICP failed.
    """
    run_module(__name__, str(folder.absolute()), mode)
    times_s = np.load(folder / STAMPS) + (scan_s / 2 if mode == "no_times" else scan_s)
    return TimedTransforms(times_s, np.load(folder / _poses(mode)))


def _poses(mode: str) -> str:
    return f"poses_{mode}.npy"


def _find(folder: Path, mode: str) -> FloatArray:
    from kiss_icp.config import load_config
    from kiss_icp.kiss_icp import KissICP

    config = load_config(None)  # its defaults: up to 100 m, voxels of 1 m
    config.data.deskew = mode == "own_motion"
    config.registration.max_num_threads = 1  # modes run beside each other
    program, poses = KissICP(config), []
    points = "moved_m" if mode == "true_motion" else "points_m"
    for file in sorted(folder.glob(SCANS)):
        with np.load(file) as scan:
            frame, shares = (scan[name].astype(np.float64) for name in (points, "share"))
        program.register_frame(frame, shares)
        poses.append(program.last_pose)
    return np.array(poses)


def main() -> None:
    """Write the poses that one mode finds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("mode")
    options = parser.parse_args()
    np.save(options.folder / _poses(options.mode), _find(options.folder, options.mode))


if __name__ == "__main__":
    main()
