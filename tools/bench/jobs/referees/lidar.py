"""A rover's drive with a lidar, and what KISS-ICP makes of its scans."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oaisys_core.config import SimulationConfig, config_from_mapping
from oaisys_core.drive.drive import Drive, TimedSample
from oaisys_core.drive.schedule import NANOSECONDS
from oaisys_core.geometry import distances_along_m
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory import Trajectory
from oaisys_core.types import FloatArray, LidarInfo, merge
from oaisys_mapping.odometry.lidar_odometry import judge
from oaisys_mapping.odometry.trajectories import TimedTransforms, time_offset_s
from tools.bench.referees.drivable_way import free_ground, slalom, there_and_back
from tools.bench.referees.lidar_odometry import MODES, Mode, TimedScan, odometry, write_scans
from tools.bench.settings import Say, Settings
from tools.bench.worlds.panel import DEMO, world_file, world_mapping

LIDAR = "lidar"
RATE_HZ = 10.0
SCAN: dict[str, Any] = {"kind": "rotating", "preset": "generic_64", "azimuth_steps": 1024}
"""As many rays as one of today's lidars with 64 channels casts at 10 Hz."""
RANGE_M = 100.0
"""Of the lidar; KISS-ICP's default, too."""
ROVER: dict[str, float] = {"speed_m_s": 3.0, "acceleration_m_s2": 1.0, "suspension_m": 1.0}
"""With the default suspension, which is meant for 1 m/s, it shakes."""
CELL_M = 0.25
CANYON_M = 200.0
TRUTH_STEP_S = 0.02


@dataclass(frozen=True)
class LidarDrive:
    """A drive whose scans are in a folder.

    Attributes:
        folder: Of `write_scans`.
        lidar: The lidar.
        truth: Poses of ``base_link``.
        obstacle: What the rover stopped in front of; empty: nothing.
    """

    folder: Path
    lidar: LidarInfo
    truth: TimedTransforms
    obstacle: str


def drive(
    settings: Settings,
    say: Say,
    world: str,
    way_m: float,
    late_s: float,
    modes: Sequence[Mode] = MODES,
    rover: Mapping[str, float] | None = None,
    slalom_m: tuple[float, float] | None = None,
    scan: Mapping[str, Any] = SCAN,
) -> dict[str, Any]:
    """Return KISS-ICP's figures of one drive by `Mode`, and how fast the rover turned.

    Args:
        settings: Of the run.
        say: Called with the progress.
        world: A world of the panel; ``stage_canyon`` is made `CANYON_M` wide.
        way_m: Length of the drive; it is shorter where the free ground ends.
        late_s: The offset of the stamps is also sought with stamps that are late by this.
        modes: How points are corrected for the motion; with ``own_motion``.
        rover: What differs from `ROVER`.
        slalom_m: Amplitude and length of the waves of a slalom around the way.
        scan: Pattern of the lidar.
    """
    with TemporaryDirectory() as temporary:
        recorded = _record(
            settings, say, world, way_m, {**ROVER, **(rover or {})}, slalom_m, scan, Path(temporary)
        )
        say(0.5, f"{world}: KISS-ICP")
        with ThreadPoolExecutor(len(modes)) as pool:
            found = pool.map(
                lambda mode: odometry(recorded.folder, mode, recorded.lidar.period_s), modes
            )
            estimates = dict(zip(modes, found, strict=True))
    lidar = recorded.truth.mount(recorded.lidar.T_base_lidar)
    late = estimates["own_motion"].delay(late_s)
    judgements: dict[str, Any] = {
        mode: asdict(judge(estimate, recorded.truth, recorded.lidar.T_base_lidar, 0.0))
        for mode, estimate in estimates.items()
    }
    return {
        "obstacle": recorded.obstacle,
        "yaw_rate_deg_s": _yaw_rate_deg_s(lidar),
        "late_offset_s": time_offset_s(late, lidar),
        **judgements,
    }


def _yaw_rate_deg_s(lidar: TimedTransforms) -> float:
    """Return the RMS of the turn rate about z."""
    rotations = Rotation.from_matrix(lidar.T[:, :3, :3])
    turns_deg = (rotations[:-1].inv() * rotations[1:]).as_rotvec(degrees=True)[:, 2]
    return float(np.sqrt(np.mean((turns_deg / np.diff(lidar.times_s)) ** 2)))


def _record(
    settings: Settings,
    say: Say,
    world: str,
    way_m: float,
    rover: Mapping[str, float],
    slalom_m: tuple[float, float] | None,
    scan: Mapping[str, Any],
    folder: Path,
) -> LidarDrive:
    config = _config(settings, world, rover, scan, [(0.0, 0.0), (1.0, 1.0)])
    simulation = Simulation(config)
    try:
        say(0.0, f"{world}: the world")
        simulation.step_batch()
        waypoints_m = _way(simulation, way_m, slalom_m).tolist()
        config = _config(settings, world, rover, scan, waypoints_m)
        planned = Drive(simulation, config, sensors=[LIDAR])
        trajectory, count = planned.plan.trajectory, planned.sample_count()
        (lidar,) = simulation.info().lidars
        text = f"{world}: {planned.plan.length_m():.0f} m"

        def scans() -> Iterator[TimedScan]:
            for i, sample in enumerate(planned.samples()):
                say(0.1 + 0.4 * i / count, text)
                yield _time_scan(sample, trajectory, lidar)

        write_scans(folder, scans())
    finally:
        simulation.close()
    times_s = np.arange(trajectory.start_s, trajectory.end_s, TRUTH_STEP_S)
    truth = TimedTransforms(times_s, trajectory.T_map_base(times_s))
    return LidarDrive(folder, lidar, truth, str(planned.plan.obstacle or ""))


def _time_scan(sample: TimedSample, trajectory: Trajectory, lidar: LidarInfo) -> TimedScan:
    """Return a scan, and its points as they would be had the lidar stood where the scan ends."""
    points = sample.sample.scan(LIDAR).data
    points_m = np.stack([points[axis] for axis in "xyz"], axis=-1).astype(np.float64)
    stamp_s = sample.time_ns / NANOSECONDS
    at_s, column = np.unique(points["time"].astype(np.float64), return_inverse=True)
    poses = trajectory.mount(lidar.T_base_lidar)
    T = np.linalg.inv(poses(np.array([stamp_s + lidar.period_s]))[0]) @ poses(stamp_s + at_s)
    moved_m = np.einsum("nij,nj->ni", T[column, :3, :3], points_m) + T[column, :3, 3]
    return TimedScan(stamp_s, points_m, moved_m, points["time"] / lidar.period_s)


def _config(
    settings: Settings,
    world: str,
    rover: Mapping[str, float],
    scan: Mapping[str, Any],
    waypoints_m: Sequence[Any],
) -> SimulationConfig:
    plain = world_mapping(settings, world)
    del plain["sensors"]["cameras"]
    plain["sensors"].pop("motion", None)
    # A smoothed attitude leaves the ground; what stands on it is driven around.
    vehicle = {"kind": "rover", "clearance_m": 2.0, **rover}
    vehicle["on_obstacle"] = "stop"
    changes: dict[str, Any] = {
        "backend": "analytic",  # both cast the same rays
        "materials": {"texture_size_px": 256},
        "sensors": {
            "pose_policy": "allow",  # a camera that takes no part is on the ground
            "lidars": [
                {
                    "name": LIDAR,
                    "mount_position_m": (0.3, 0.0, 2.0),
                    "scan": dict(scan),
                    "max_range_m": RANGE_M,
                    "rate_hz": RATE_HZ,
                }
            ],
        },
        "drive": {"vehicle": vehicle, "waypoints_m": waypoints_m},
    }
    if world != DEMO:
        changes["stage"] = {"extent_m": CANYON_M}
    return config_from_mapping(merge(plain, changes), world_file(world).parent)


def _way(simulation: Simulation, way_m: float, slalom_m: tuple[float, float] | None) -> FloatArray:
    """Return waypoints of a way, cut off at its length."""
    way = there_and_back(free_ground(simulation.height_grid(CELL_M)))
    way = way[distances_along_m(way) <= way_m]
    if slalom_m is not None:
        way = slalom(way, *slalom_m)
    return np.asarray(way[distances_along_m(way) <= way_m])
