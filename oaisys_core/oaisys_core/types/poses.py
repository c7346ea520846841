"""Poses of the rig, true and estimated."""

from __future__ import annotations

from dataclasses import dataclass

from oaisys_core.types.arrays import FloatArray, ShortRepr


@dataclass(frozen=True)
class Pose:
    """Position and orientation of a body frame in ``map`` (REP-103: x forward, y left, z up).

    Attributes:
        position_m: (x, y, z) in metres.
        quat_xyzw: Unit quaternion that rotates body coordinates into ``map``.
    """

    position_m: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


@dataclass(frozen=True)
class Odometry:
    """A drifting rig's estimate of its pose.

    Attributes:
        pose: Estimated pose of the rig in ``map``.
        sigma_m, sigma_rad: Standard deviation of its error along and about each axis.
    """

    pose: Pose
    sigma_m: float
    sigma_rad: float


@dataclass(frozen=True)
class Twist:
    """Velocity of a body, in its own axes, as in ``nav_msgs/Odometry``.

    Attributes:
        velocity_m_s: Linear velocity.
        angular_rate_rad_s: Angular rate.
    """

    velocity_m_s: tuple[float, float, float]
    angular_rate_rad_s: tuple[float, float, float]


@dataclass(frozen=True, repr=False)
class TimedPoses(ShortRepr):
    """Poses of ``base_link`` in ``map`` at K times, with a smooth motion between them.

    Attributes:
        times_s: (K,) increasing times.
        positions_m: (K, 3) positions.
        quats_xyzw: (K, 4) orientations.
    """

    times_s: FloatArray
    positions_m: FloatArray
    quats_xyzw: FloatArray
