"""A drone: smooth flight through waypoints within limits of speed and acceleration."""

from __future__ import annotations

import numpy as np
import scipy

from oaisys_core.config.sections.drive import DroneConfig
from oaisys_core.trajectory.speed_profile import KNOT_INTERVAL_S, distances_over_time
from oaisys_core.trajectory.trajectory import Trajectory
from oaisys_core.trajectory.waypoint_curve import WaypointCurve
from oaisys_core.types import FloatArray

STEP_M = 0.05
MAX_STEPS = 200_000
"""Distance between places at which the speed is chosen, and the largest number of them."""

MIN_HORIZONTAL = 0.05
"""Where the way's direction has a smaller horizontal part, it does not define a heading."""

SHARE = 0.5**0.5
"""Share of the acceleration that is used along the way, and across it."""


def plan_flight(config: DroneConfig, waypoints_m: FloatArray, gravity_m_s2: float) -> Trajectory:
    """Return the flight through (K, 3) waypoints, from rest at time 0 to rest.

    The drone is as fast as its limits allow, and hovers for ``hover_s`` at each waypoint. With one
    waypoint, it only hovers there.

    Raises:
        InvalidInputError: Successive waypoints are the same.
    """
    if len(waypoints_m) == 1:
        times_s = np.array((0.0, max(config.hover_s, KNOT_INTERVAL_S)))
        yaw_rad = 0.0 if config.heading == "way" else np.radians(config.heading)
        quat_xyzw = (0.0, 0.0, np.sin(yaw_rad / 2), np.cos(yaw_rad / 2))
        return Trajectory(times_s, np.repeat(waypoints_m, 2, axis=0), (quat_xyzw, quat_xyzw))
    curve = WaypointCurve(waypoints_m)
    times_s, arc_m = _schedule(config, curve)
    positions_m = curve.position_m(arc_m)
    times_s = times_s * _slowdown(config, times_s, positions_m)
    up = np.tile((0.0, 0.0, 1.0), (len(times_s), 1))
    if config.tilts:
        acceleration = scipy.interpolate.CubicSpline(times_s, positions_m)(times_s, 2)
        up = acceleration + np.array((0.0, 0.0, gravity_m_s2)) if gravity_m_s2 else up
    yaws_rad = _yaws_rad(config, curve, arc_m)
    return Trajectory(times_s, positions_m, _attitudes(up, yaws_rad))


def _schedule(config: DroneConfig, curve: WaypointCurve) -> tuple[FloatArray, FloatArray]:
    """Return times and arc lengths of the flight."""
    count = int(np.clip(curve.length_m / STEP_M, 16, MAX_STEPS))
    even_m = np.linspace(0.0, curve.length_m, count + 1)
    places_m = np.unique(np.append(even_m, curve.waypoint_arc_m))
    # The last waypoint's arc length may differ from the length by rounding.
    places_m = places_m[np.append(np.diff(places_m) > 1e-9 * curve.length_m, True)]
    bend = np.maximum(curve.curvature(places_m), 1e-9)
    acceleration_m_s2 = SHARE * config.acceleration_m_s2
    limits_m_s = np.minimum(config.speed_m_s, np.sqrt(acceleration_m_s2 / bend))
    stops: dict[int, float] = {}
    if config.hover_s:
        nearest = [int(np.argmin(np.abs(places_m - m))) for m in curve.waypoint_arc_m]
        stops = dict.fromkeys(nearest, config.hover_s)
    return distances_over_time(places_m, limits_m_s, acceleration_m_s2, stops)


def _slowdown(config: DroneConfig, times_s: FloatArray, positions_m: FloatArray) -> float:
    """Return the factor on time with which the flight keeps its limits exactly."""
    spline = scipy.interpolate.CubicSpline(times_s, positions_m)
    # The acceleration is linear between poses; the speed is sampled in between, too.
    between_s = np.linspace(0.0, times_s[-1], 4 * len(times_s))
    fastest = np.linalg.norm(spline(between_s, 1), axis=1).max() / config.speed_m_s
    hardest = np.linalg.norm(spline(times_s, 2), axis=1).max() / config.acceleration_m_s2
    return float(max(1.0, fastest * (1 + 1e-4), hardest**0.5))


def _yaws_rad(config: DroneConfig, curve: WaypointCurve, arc_m: FloatArray) -> FloatArray:
    if config.heading != "way":
        return np.full(len(arc_m), np.radians(config.heading))
    tangent = curve.tangent(arc_m)
    is_known = np.hypot(tangent[:, 0], tangent[:, 1]) > MIN_HORIZONTAL
    if not is_known.any():
        return np.zeros(len(arc_m))
    known = np.unwrap(np.arctan2(tangent[is_known, 1], tangent[is_known, 0]))
    return np.interp(np.arange(len(arc_m)), np.flatnonzero(is_known), known)


def _attitudes(up: FloatArray, yaws_rad: FloatArray) -> FloatArray:
    """Return (N, 4) quaternions with z along ``up`` and x as near as possible to the heading."""
    from scipy.spatial.transform import Rotation

    z = up / np.linalg.norm(up, axis=1, keepdims=True)
    heading = np.column_stack((np.cos(yaws_rad), np.sin(yaws_rad), np.zeros(len(z))))
    y = np.cross(z, heading)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    columns = np.stack((np.cross(y, z), y, z), axis=-1)
    return np.asarray(Rotation.from_matrix(columns).as_quat())
