"""GTSAM's preintegration of an IMU against the true motion.

``python -m oaisys_mapping.odometry.inertial FILE.npz`` runs it, so that GTSAM's libraries are in a
process of their own.
"""

from __future__ import annotations

import argparse
import importlib.util
import io
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from oaisys_core.system.python_programs import python_command
from oaisys_core.types import FloatArray
from oaisys_mapping.odometry.programs import ProgramError, program_folder, run_program
from oaisys_mapping.odometry.trajectories import TimedTransforms

GTSAM = "gtsam"
LONGEST_S = 30.0
"""The IMU is integrated for at most so long."""
WINDOW_S = 0.5
"""Length of the windows from which the IMU's orientation is found."""


@dataclass(frozen=True)
class ImuFigures:
    """How well the integrated IMU follows the true motion.

    Attributes:
        seconds: How long it was integrated, from the true pose and velocity.
        way_m: Length of the IMU's true way in that time.
        end_error_m: Distance from the true position at the end.
        end_error_share: The same as a share of the way.
        turned_deg: Angle by which the IMU is turned against its mount, from changes of velocity
            and orientation.
    """

    seconds: float
    way_m: float
    end_error_m: float
    end_error_share: float
    turned_deg: float


def preintegrate(
    measurements: FloatArray,
    truth: TimedTransforms,
    twists: FloatArray,
    T_base_imu: ArrayLike,
    gravity_m_s2: float,
) -> ImuFigures:
    """Integrate an IMU with GTSAM, and compare with the true motion.

    Args:
        measurements: (N, 7) times, angular rates and specific forces.
        truth: (M,) true poses of ``base_link``.
        twists: (M, 6) true velocities and angular rates of ``base_link``, in its axes.
        T_base_imu: (4, 4) mount of the IMU.
        gravity_m_s2: Gravity, along -z.

    Raises:
        ProgramError: GTSAM is not installed, or fails.
    """
    if importlib.util.find_spec(GTSAM) is None:
        raise ProgramError(f"{GTSAM} is not installed")
    with program_folder() as folder:
        # In memory first: a ZIP file whose disk is full complains once more when it is forgotten.
        packed = io.BytesIO()
        np.savez(
            packed,
            measurements=measurements,
            times_s=truth.times_s,
            T=truth.T,
            twists=twists,
            T_base_imu=np.asarray(T_base_imu),
            gravity_m_s2=gravity_m_s2,
        )
        file = folder / "imu.npz"
        file.write_bytes(packed.getbuffer())
        command = python_command(__name__, str(file))
        return ImuFigures(**json.loads(run_program(command, folder)))


class _Motion:
    """The true motion of the IMU."""

    def __init__(self, data: Any) -> None:
        base = TimedTransforms(data["times_s"], data["T"])
        mount, twists = data["T_base_imu"], data["twists"]
        self._imu = base.mount(mount)
        in_base = twists[:, :3] + np.cross(twists[:, 3:], mount[:3, 3])
        self._velocity_m_s = np.einsum("nij,nj->ni", base.T[:, :3, :3], in_base)

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (N, 4, 4) poses and (N, 3) velocities in ``map`` at (N,) times."""
        velocities = [np.interp(times_s, self._imu.times_s, v) for v in self._velocity_m_s.T]
        return self._imu.at(times_s).T, np.stack(velocities, axis=-1)

    @property
    def end_s(self) -> float:
        """The last time at which it is known."""
        return float(self._imu.times_s[-1])


def _figures(data: Any) -> ImuFigures:
    motion, gravity_m_s2 = _Motion(data), float(data["gravity_m_s2"])
    measured = data["measurements"]
    end_s = min(motion.end_s, measured[0, 0] + LONGEST_S)
    measured = measured[measured[:, 0] <= end_s]
    times_s = measured[:, 0]
    T, velocity_m_s = motion.at(times_s)
    way_m = float(np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum())
    end_m = _predict_end_m(measured, T[0], velocity_m_s[0], gravity_m_s2)
    error_m = float(np.linalg.norm(end_m - T[-1, :3, 3]))
    return ImuFigures(
        seconds=float(times_s[-1] - times_s[0]),
        way_m=way_m,
        end_error_m=error_m,
        end_error_share=error_m / way_m,
        turned_deg=_rotation_deg(measured, T, velocity_m_s, gravity_m_s2),
    )


def _integrate(measured: FloatArray, gravity_m_s2: float) -> Any:
    """Return GTSAM's preintegration of consecutive measurements by the midpoint rule.

    GTSAM takes a specific force as constant in the axes that the IMU has when an interval begins,
    so that of its middle is turned back by half of the interval's turn.
    """
    import gtsam

    parameters = gtsam.PreintegrationParams.MakeSharedU(gravity_m_s2)
    # GTSAM weighs by them, but predictions do not depend on them.
    for covariance in ("Gyroscope", "Accelerometer", "Integration"):
        getattr(parameters, f"set{covariance}Covariance")(np.eye(3) * 1e-8)
    integrated = gtsam.PreintegratedImuMeasurements(parameters, gtsam.imuBias.ConstantBias())
    middle, steps_s = (measured[1:] + measured[:-1]) / 2, np.diff(measured[:, 0])
    rates = middle[:, 1:4]
    forces = Rotation.from_rotvec(rates * steps_s[:, None] / 2).apply(middle[:, 4:7])
    for force, rate, step_s in zip(forces, rates, steps_s, strict=True):
        integrated.integrateMeasurement(force, rate, float(step_s))
    return integrated


def _predict_end_m(
    measured: FloatArray, T_map_imu: FloatArray, velocity_m_s: FloatArray, gravity_m_s2: float
) -> FloatArray:
    import gtsam

    start = gtsam.NavState(gtsam.Pose3(T_map_imu), velocity_m_s)
    integrated = _integrate(measured, gravity_m_s2)
    end = integrated.predict(start, gtsam.imuBias.ConstantBias())
    return np.asarray(end.pose().translation())


def _rotation_deg(
    measured: FloatArray, T: FloatArray, velocity_m_s: FloatArray, gravity_m_s2: float
) -> float:
    """Return the angle of the rotation that best takes measured to true changes of motion."""
    rate_hz = (len(measured) - 1) / (measured[-1, 0] - measured[0, 0])
    length = max(2, round(WINDOW_S * rate_hz))
    down = np.array((0.0, 0.0, -gravity_m_s2))
    found, expected = [], []
    for first in range(0, len(measured) - length, length):
        rows = measured[first : first + length + 1]
        integrated = _integrate(rows, gravity_m_s2)
        found.append(integrated.deltaVij())
        changed = velocity_m_s[first + length] - velocity_m_s[first]
        expected.append(T[first, :3, :3].T @ (changed - down * (rows[-1, 0] - rows[0, 0])))
        turned = Rotation.from_matrix(T[first, :3, :3].T @ T[first + length, :3, :3])
        found.append(Rotation.from_matrix(integrated.deltaRij().matrix()).as_rotvec())
        expected.append(turned.as_rotvec())
    rotation, _ = Rotation.align_vectors(np.array(expected), np.array(found))
    return float(np.degrees(rotation.magnitude()))


def main() -> None:
    """Print the figures of one file as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    with np.load(parser.parse_args().file) as data:
        print(json.dumps(asdict(_figures(data))))  # noqa: T201 - the parent reads it


if __name__ == "__main__":
    main()
