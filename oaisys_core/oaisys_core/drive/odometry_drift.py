"""Odometry that drifts with the way."""

from __future__ import annotations

import numpy as np

from oaisys_core import randomness
from oaisys_core.config.sections.drive import OdometryDriftConfig
from oaisys_core.trajectory import Trajectory
from oaisys_core.types import FloatArray, Odometry, Pose


class OdometryDrift:
    """What odometry estimates along a trajectory.

    The errors walk randomly from one measurement of odometry to the next; in between they change
    linearly.

    Args:
        config: The errors.
        trajectory: The true motion.
        times_s: (N,) times at which odometry measures.
        batch_seed: Seed of the world, so that each world has errors of its own.
    """

    def __init__(
        self,
        config: OdometryDriftConfig,
        trajectory: Trajectory,
        times_s: FloatArray,
        batch_seed: int,
    ) -> None:
        self._config = config
        self._trajectory = trajectory
        self._times_s = times_s
        steps_m = np.linalg.norm(np.diff(trajectory.position_m(times_s), axis=0), axis=1)
        self._way_m = np.concatenate(([0.0], np.cumsum(steps_m)))
        rng = randomness.stream(batch_seed, "odometry", config.seed)
        steps = rng.standard_normal((len(steps_m), 6)) * np.sqrt(steps_m)[:, None]
        self._walk = np.vstack((np.zeros(6), np.cumsum(steps, axis=0)))

    def estimates(self, times_s: FloatArray) -> list[Odometry]:
        """Return the estimated poses of ``base_link`` at (N,) times."""
        from scipy.spatial.transform import Rotation

        positions_m = self._trajectory.position_m(times_s)
        start_m = self._trajectory.position_m([self._times_s[0]])
        walk = self._at(self._walk, times_s)
        sigma_m, sigma_rad = self._sigmas()
        estimated_m = positions_m + self._config.scale_error * (positions_m - start_m)
        estimated_m += sigma_m * walk[:, :3]
        turned = Rotation.from_rotvec(sigma_rad * walk[:, 3:]) * self._trajectory.rotation(times_s)
        roots = np.sqrt(self._at(self._way_m, times_s))
        return [
            Odometry(Pose((x, y, z), (qx, qy, qz, qw)), float(sigma_m * root), sigma_rad * root)
            for (x, y, z), (qx, qy, qz, qw), root in zip(
                estimated_m.tolist(),
                turned.as_quat(canonical=True).tolist(),
                roots.tolist(),
                strict=True,
            )
        ]

    def _sigmas(self) -> tuple[float, float]:
        """Return the standard deviations of position and orientation after 1 m."""
        rotation_rad = float(np.radians(self._config.rotation_deg_per_sqrt_m))
        return self._config.position_m_per_sqrt_m, rotation_rad

    def _at(self, values: FloatArray, times_s: FloatArray) -> FloatArray:
        """Return (N, ...) values of odometry's measurements at other times."""
        columns = values.reshape(len(values), -1).T
        found = np.stack([np.interp(times_s, self._times_s, column) for column in columns], axis=-1)
        return found.reshape(len(times_s), *values.shape[1:])
