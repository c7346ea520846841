"""What GTSAM makes of the IMU of a flight, and evo of odometry that drifts."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oaisys_core.config.sections.drive import GRAVITY_M_S2, DroneConfig, OdometryDriftConfig
from oaisys_core.config.sections.sensing.imu import ImuConfig
from oaisys_core.drive.odometry_drift import OdometryDrift
from oaisys_core.geometry import distances_along_m
from oaisys_core.trajectory import Trajectory
from oaisys_core.trajectory.drone import plan_flight
from oaisys_core.trajectory.imu import imu_info, measure
from oaisys_mapping.odometry.inertial import ImuFigures, preintegrate
from oaisys_mapping.odometry.trajectories import TimedTransforms
from tools.bench.settings import Say, Settings

GRAVITY = GRAVITY_M_S2["mars"]
WAYPOINTS_M = np.array(
    [(0, 0, 5), (12, 4, 8), (20, 16, 6), (8, 24, 9), (-6, 14, 7), (-2, 2, 6), (9, -5, 6)], float
)
ODOMETRY_HZ = 50.0
POSITION_M_PER_SQRT_M = 0.02


def imu(settings: Settings, say: Say, turned_deg: float) -> dict[str, Any]:
    """Return GTSAM's figures of the IMU of a flight, as it is and turned unknown to GTSAM.

    Args:
        settings: Of the run.
        say: Called with the progress.
        turned_deg: About y.
    """
    del settings
    flight = plan_flight(DroneConfig(kind="drone"), WAYPOINTS_M, GRAVITY)
    plain = ImuConfig(mount_position_m=(0.2, -0.1, 0.3))
    x, y, z, w = Rotation.from_euler("y", turned_deg, degrees=True).as_quat().tolist()
    say(0.0, "GTSAM")
    turned = plain.model_copy(update={"mount_quat_xyzw": (x, y, z, w)})
    return {
        name: asdict(_preintegrate(flight, mounted, plain))
        for name, mounted in (("plain", plain), ("turned", turned))
    }


def _preintegrate(flight: Trajectory, mounted: ImuConfig, believed: ImuConfig) -> ImuFigures:
    times_s = np.arange(0.0, flight.end_s, 1 / mounted.rate_hz)
    measured = measure(mounted, flight, times_s, GRAVITY)
    table = np.column_stack((times_s, measured.angular_rate_rad_s, measured.specific_force_m_s2))
    odometry_s = np.arange(0.0, flight.end_s, 1 / ODOMETRY_HZ)
    to_base = flight.rotation(odometry_s).inv()
    twists = np.hstack(
        (to_base.apply(flight.velocity_m_s(odometry_s)), flight.angular_rate_rad_s(odometry_s))
    )
    truth = TimedTransforms(odometry_s, flight.T_map_base(odometry_s))
    return preintegrate(table, truth, twists, imu_info(believed).T_base_imu, GRAVITY)


def odometry_drift(settings: Settings, say: Say, seeds: int) -> dict[str, float]:
    """Return evo's APE of odometry that drifts along the flight, and what it is to be.

    Args:
        settings: Of the run.
        say: Called with the progress.
        seeds: Number of drifts whose squares are averaged.
    """
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    del settings
    flight = plan_flight(DroneConfig(kind="drone"), WAYPOINTS_M, GRAVITY)
    times_s = np.arange(0.0, flight.end_s, 1 / ODOMETRY_HZ)
    true_m = flight.position_m(times_s)
    quats_wxyz = np.roll(flight.rotation(times_s).as_quat(), 1, axis=1)
    reference = PoseTrajectory3D(true_m, quats_wxyz, times_s)
    squares = []
    for seed in range(seeds):
        say(seed / seeds, "evo")
        config = OdometryDriftConfig(seed=seed, position_m_per_sqrt_m=POSITION_M_PER_SQRT_M)
        drift = OdometryDrift(config, flight, times_s, batch_seed=1)
        found_m = np.array([each.pose.position_m for each in drift.estimates(times_s)])
        ape = metrics.APE(metrics.PoseRelation.translation_part)
        ape.process_data((reference, PoseTrajectory3D(found_m, quats_wxyz, times_s)))
        squares.append(ape.get_statistic(metrics.StatisticsType.rmse) ** 2)
    # On three axes, the mean square after s metres is 3 sigma^2 s.
    expected_m = POSITION_M_PER_SQRT_M * np.sqrt(3 * distances_along_m(true_m).mean())
    return {"ape_m": float(np.sqrt(np.mean(squares))), "expected_m": float(expected_m)}
