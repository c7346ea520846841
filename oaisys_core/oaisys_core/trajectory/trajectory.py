"""A trajectory: the pose of a body as a smooth function of time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import MAX_M, check_position, expect_unit_norm
from oaisys_core.scene.rig_motion import TIME_TOLERANCE_S, RigMotion
from oaisys_core.types import FloatArray, Pose

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

TransformAt = Callable[[ArrayLike], FloatArray]
"""Returns the (N, 4, 4) poses of a frame in ``map`` at (N,) times in seconds."""


class Trajectory:
    """The pose of ``base_link`` in ``map`` between two times, twice continuously differentiable.

    The position is the cubic spline through the given poses, and the orientation scipy's
    `RotationSpline`, whose angular acceleration is continuous. A spline through poses of another
    motion approximates it; its angular rate is less exact in the first and last few intervals,
    because it begins and ends with the mean rates of the first and the last interval.

    All methods take (N,) times in seconds from `start_s` to `end_s`. Linear quantities are in
    ``map``, angular ones in ``base_link``, as a gyroscope measures them.

    Attributes:
        times_s: (K,) times of the given poses.
        positions_m: (K, 3) their positions.
        quats_xyzw: (K, 4) their orientations.
    """

    def __init__(self, times_s: ArrayLike, positions_m: ArrayLike, quats_xyzw: ArrayLike) -> None:
        """Interpolate poses.

        Raises:
            InvalidInputError: There are fewer than two poses, times do not increase, numbers are
                not finite, or a quaternion is off unit norm.
        """
        from scipy.spatial.transform import Rotation, RotationSpline

        self.times_s = _check("times_s", times_s, ())
        self.positions_m = _check("positions_m", positions_m, (3,))
        if (far := np.abs(self.positions_m).max(axis=1, initial=0.0) > MAX_M).any():
            row = int(np.argmax(far))
            check_position(self.positions_m[row], f"trajectory.positions_m.{row}")
        self.quats_xyzw = _check("quats_xyzw", quats_xyzw, (4,))
        counts = {len(self.times_s), len(self.positions_m), len(self.quats_xyzw)}
        if len(counts) > 1 or len(self.times_s) < 2:
            expected = "at least two poses, each with a time, a position and an orientation"
            raise InvalidInputError("trajectory", sorted(counts), expected)
        steps_s = np.diff(self.times_s)
        if not (steps_s > 0).all():
            row = int(np.argmin(steps_s > 0)) + 1
            expected = f"a time after {self.times_s[row - 1]:.9g} s"
            raise InvalidInputError(f"trajectory.times_s.{row}", float(self.times_s[row]), expected)
        norms = np.linalg.norm(self.quats_xyzw, axis=1)
        worst = int(np.argmax(np.abs(norms - 1.0)))
        if expected := expect_unit_norm(float(norms[worst])):
            field = f"trajectory.quats_xyzw.{worst}"
            raise InvalidInputError(field, self.quats_xyzw[worst].tolist(), expected)
        # Seconds since 1970 would cost the spline half of its digits.
        knots_s = self.times_s - self.times_s[0]
        self._positions = scipy.interpolate.CubicSpline(knots_s, self.positions_m)
        self._rotations = RotationSpline(knots_s, Rotation.from_quat(self.quats_xyzw))

    @property
    def start_s(self) -> float:
        """Time of the first pose."""
        return float(self.times_s[0])

    @property
    def end_s(self) -> float:
        """Time of the last pose."""
        return float(self.times_s[-1])

    @property
    def duration_s(self) -> float:
        """Time from the first to the last pose."""
        return self.end_s - self.start_s

    def position_m(self, times_s: ArrayLike) -> FloatArray:
        """Return (N, 3) positions in ``map``."""
        return np.asarray(self._positions(self._since_start(times_s)))

    def velocity_m_s(self, times_s: ArrayLike) -> FloatArray:
        """Return (N, 3) velocities in ``map``."""
        return np.asarray(self._positions(self._since_start(times_s), 1))

    def acceleration_m_s2(self, times_s: ArrayLike) -> FloatArray:
        """Return (N, 3) accelerations in ``map``."""
        return np.asarray(self._positions(self._since_start(times_s), 2))

    def rotation(self, times_s: ArrayLike) -> Rotation:
        """Return N rotations of ``base_link`` in ``map``."""
        return self._rotations(self._since_start(times_s))

    def angular_rate_rad_s(self, times_s: ArrayLike) -> FloatArray:
        """Return (N, 3) angular rates of ``base_link``, in ``base_link``."""
        return np.asarray(self._rotations(self._since_start(times_s), 1))

    def angular_acceleration_rad_s2(self, times_s: ArrayLike) -> FloatArray:
        """Return the (N, 3) derivatives of the angular rate in ``base_link``."""
        return np.asarray(self._rotations(self._since_start(times_s), 2))

    def T_map_base(self, times_s: ArrayLike) -> FloatArray:  # noqa: N802 - names a transform
        """Return (N, 4, 4) poses of ``base_link`` in ``map``."""
        since_start_s = self._since_start(times_s)
        T = np.zeros((len(since_start_s), 4, 4))
        T[:, :3, :3] = self._rotations(since_start_s).as_matrix()
        T[:, :3, 3] = self._positions(since_start_s)
        T[:, 3, 3] = 1.0
        return T

    def mount(self, T_base_sensor: ArrayLike) -> TransformAt:
        """Return the function from (N,) times to (N, 4, 4) poses of a sensor in ``map``.

        Args:
            T_base_sensor: (4, 4) pose of the sensor in ``base_link``.
        """
        mount = np.array(T_base_sensor, dtype=np.float64)
        return lambda times_s: np.asarray(self.T_map_base(times_s) @ mount)

    def pose(self, time_s: float) -> Pose:
        """Return the pose at one time, with a quaternion whose w is not negative."""
        x, y, z = self.position_m([time_s])[0].tolist()
        qx, qy, qz, qw = self.rotation([time_s]).as_quat(canonical=True)[0].tolist()
        return Pose((x, y, z), (qx, qy, qz, qw))

    def motion_about(self, time_s: float, first_s: float, last_s: float) -> RigMotion:
        """Return the motion about a sample.

        Args:
            time_s: Time of the sample.
            first_s, last_s: Times since the sample that it must cover. Before the trajectory, where
                the first exposure begins, the rig has the velocity and the angular rate with which
                the trajectory begins.

        Raises:
            InvalidInputError: The sample's time or the last one is outside of the trajectory.
        """
        begin_s, end_s = self._since_start([time_s, time_s + last_s]).tolist()
        knots_s = np.asarray(self._positions.x)
        low = max(int(np.searchsorted(knots_s, begin_s + first_s, side="right")) - 1, 0)
        low = min(low, len(knots_s) - 2)
        high = max(int(np.searchsorted(knots_s, end_s)), low + 1)
        motion = RigMotion(
            knots_s=knots_s[low : high + 1] - begin_s,
            positions=np.asarray(self._positions.c[:, low:high]),
            quats_xyzw=self._rotations.rotations[low:high].as_quat(),
            turns=np.asarray(self._rotations.interpolator.c[:, low:high]),
        )
        earlier_s = -(begin_s + first_s)
        return motion.with_earlier_start(earlier_s) if earlier_s > 0 else motion

    def _since_start(self, times_s: ArrayLike) -> FloatArray:
        """Return times since the start.

        Raises:
            InvalidInputError: A time is outside of the trajectory.
        """
        times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
        outside = ~(
            (times >= self.start_s - TIME_TOLERANCE_S) & (times <= self.end_s + TIME_TOLERANCE_S)
        )
        if outside.any():
            expected = f"a time of the trajectory, {self.start_s:.9g} s to {self.end_s:.9g} s"
            raise InvalidInputError("time_s", float(times[outside][0]), expected)
        return np.asarray(np.clip(times - self.times_s[0], 0.0, self.duration_s))


def _check(name: str, values: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return a read-only copy of an array of (K, *shape) finite numbers."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 + len(shape) or array.shape[1:] != shape or not np.isfinite(array).all():
        expected = f"finite numbers of shape {('K', *shape)}".replace("'", "")
        raise InvalidInputError(f"trajectory.{name}", array.shape, expected)
    array.setflags(write=False)
    return array
