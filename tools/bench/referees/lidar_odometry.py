"""KISS-ICP on the scans of a drive, in a process of its own.

``python -m tools.bench.referees.lidar_odometry FOLDER MODE MAX_RANGE_M VOXEL_M`` writes its poses.
The folder has the scans, see `write_scans`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
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

POINTS, MOVED, SHARES, COUNTS, STAMPS = (
    f"{name}.npy" for name in ("points", "moved", "shares", "counts", "stamps")
)


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


def write_scans(folder: Path, scans: Sequence[TimedScan]) -> None:
    """Write scans for `odometry`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, arrays in (
        (POINTS, [scan.points_m for scan in scans]),
        (MOVED, [scan.moved_m for scan in scans]),
        (SHARES, [scan.share for scan in scans]),
    ):
        np.save(folder / name, np.concatenate(arrays).astype(np.float32))
    np.save(folder / COUNTS, np.array([len(scan.share) for scan in scans]))
    np.save(folder / STAMPS, np.array([scan.stamp_s for scan in scans]))


def odometry(
    folder: Path, mode: Mode, scan_s: float, max_range_m: float, voxel_m: float
) -> TimedTransforms:
    """Return the lidar's poses as KISS-ICP finds them, at the times for which they hold.

    Args:
        folder: Written by `write_scans`.
        mode: How points are corrected for the motion.
        scan_s: How long a scan takes. With uncorrected points, a pose holds on the average for
            the middle of its scan, otherwise for the end.
        max_range_m: Farther points are ignored.
        voxel_m: Edge of the map's voxels.

    Raises:
        ProgramError: KISS-ICP failed.
    """
    run_module(__name__, str(folder.absolute()), mode, str(max_range_m), str(voxel_m))
    times_s = np.load(folder / STAMPS) + (scan_s / 2 if mode == "no_times" else scan_s)
    return TimedTransforms(times_s, np.load(folder / _poses(mode)))


def _poses(mode: str) -> str:
    return f"poses_{mode}.npy"


def _found(folder: Path, mode: str, max_range_m: float, voxel_m: float) -> FloatArray:
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.max_range = max_range_m
    config.data.deskew = mode == "own_motion"
    config.mapping.voxel_size = voxel_m
    config.registration.max_num_threads = 1  # modes run beside each other
    program, poses = KissICP(config), []
    points = np.load(folder / (MOVED if mode == "true_motion" else POINTS), mmap_mode="r")
    shares = np.load(folder / SHARES, mmap_mode="r")
    ends = np.cumsum(np.load(folder / COUNTS))
    for begin, end in zip((0, *ends[:-1]), ends, strict=True):
        frame = np.asarray(points[begin:end], np.float64)
        program.register_frame(frame, np.asarray(shares[begin:end], np.float64))
        poses.append(program.last_pose)
    return np.array(poses)


def main() -> None:
    """Write the poses that one mode finds."""
    folder, mode = Path(sys.argv[1]), sys.argv[2]
    np.save(folder / _poses(mode), _found(folder, mode, *map(float, sys.argv[3:5])))


if __name__ == "__main__":
    main()
