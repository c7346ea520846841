"""Checks of the rig's pose: its cameras must be on the stage and above its surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core import geometry
from oaisys_core.errors import InvalidInputError
from oaisys_core.types import Extent, FloatArray, HeightQuery, Pose, SensorInfo

HeightLookup = Callable[[FloatArray], HeightQuery]
"""Returns the heights below (N, 3) points in ``map``."""


MAX_EXTENTS = 1000.0
"""Largest distance of a rig from the stage's centre along an axis, in edge lengths of the stage;
further away, numbers are too coarse."""

ROUNDING_M = 1e-6
"""By how much a pose may miss the least clearance, and how far inside of the stage's edge a clamped
one is: what was admitted is admitted again as it is."""


def admit_pose(
    pose: Pose,
    sensors: Sequence[SensorInfo],
    heights: HeightLookup,
    extent_m: Extent,
    *,
    policy: str,
    least_m: float,
) -> Pose:
    """Return the pose after the policy was applied to it.

    Args:
        pose: Pose of the rig.
        sensors: The cameras of the rig.
        heights: Looks up heights of the surface.
        extent_m: (min_x, min_y, max_x, max_y) of the stage.
        policy: A `PosePolicy`: ``reject`` a pose too low or off the stage, ``clamp`` it to the
            least clearance on the stage, or ``allow`` it. Or ``lift``, for motions only: lift a
            pose that is too low, and reject one off the stage.
        least_m: Least height of each camera above the topmost surface.

    Raises:
        InvalidInputError: The policy refuses the pose; or, with any policy, it is further than
            `MAX_EXTENTS` from the stage's centre.
    """
    _check_reach(pose, extent_m)
    if policy == "allow":
        return pose
    if policy == "clamp":
        pose = _move(pose, _shift_inside_m(_positions_m(sensors, pose), extent_m))
    clearance_m = heights(_positions_m(sensors, pose)).clearance_m
    if (clearance_m >= least_m - ROUNDING_M).all():
        return pose
    if policy in ("clamp", "lift") and np.isfinite(clearance_m).all():
        return _move(pose, (0.0, 0.0, float(least_m - clearance_m.min())))
    worst = int(np.argmin(np.nan_to_num(clearance_m, nan=-np.inf)))
    raise _refusal(sensors[worst].name, pose, float(clearance_m[worst]), least_m)


def _positions_m(sensors: Sequence[SensorInfo], pose: Pose) -> FloatArray:
    T_map_base = geometry.pose_to_matrix(pose)
    return np.array([(T_map_base @ sensor.T_base_camera)[:3, 3] for sensor in sensors])


def _move(pose: Pose, offset_m: ArrayLike) -> Pose:
    x, y, z = np.asarray(pose.position_m) + np.asarray(offset_m)
    return Pose((float(x), float(y), float(z)), pose.quat_xyzw)


def _shift_inside_m(positions_m: FloatArray, extent_m: Extent) -> FloatArray:
    """Return the (3,) shift that moves all points, which are close together, onto the stage."""
    low, high = np.array(extent_m[:2]), np.array(extent_m[2:])
    too_low_m, too_high_m = low - positions_m[:, :2], positions_m[:, :2] - high
    beyond_m = [np.where(m > 0, m + ROUNDING_M, 0).max(axis=0) for m in (too_low_m, too_high_m)]
    return np.append(beyond_m[0] - beyond_m[1], 0.0)


def _check_reach(pose: Pose, extent_m: Extent) -> None:
    low, high = np.array(extent_m[:2]), np.array(extent_m[2:])
    reach_m = MAX_EXTENTS * float((high - low).max())
    from_centre_m = np.abs(np.subtract(pose.position_m, (*(low + high) / 2, 0.0)))
    if not (from_centre_m <= reach_m).all():
        expected = (
            f"at most {reach_m:g} m from the stage's centre along each axis "
            f"({MAX_EXTENTS:g} edge lengths of the stage)"
        )
        raise InvalidInputError("pose.position", list(pose.position_m), expected)


def _refusal(sensor: str, pose: Pose, clearance_m: float, least_m: float) -> InvalidInputError:
    if np.isnan(clearance_m):
        where = f"sensor {sensor!r} would be off the stage"
    else:
        side = "under" if clearance_m < 0 else "above"
        least_z_m = pose.position_m[2] - clearance_m + least_m
        where = (
            f"sensor {sensor!r} would be {abs(clearance_m):.3f} m {side} the surface; from"
            f" z = {least_z_m:.3f} m on the rig is high enough there"
        )
    return InvalidInputError(
        "pose.position",
        list(pose.position_m),
        f"a clearance of at least {least_m:g} m over the stage ({where})",
    )
