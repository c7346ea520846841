"""When a vehicle is where on its way: limits on speed and acceleration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import scipy

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

KNOT_INTERVAL_S = 0.05
"""Time between two poses through which a vehicle's trajectory is interpolated."""

LONGEST_WAY_S = 20_000.0
"""Longest time that a vehicle may need for its way."""

JERK_TIME_S = 0.3
"""Each change of acceleration is spread over twice this time."""


def distances_over_time(
    way_m: FloatArray,
    limits_m_s: FloatArray,
    acceleration_m_s2: float,
    stops: Mapping[int, float],
) -> tuple[FloatArray, FloatArray]:
    """Return (K,) times and the distances driven by then, from rest to rest.

    The vehicle is as fast as the limits allow: the greatest speed at each place, and one
    acceleration for speeding up and slowing down (a forward and a backward pass, as in time-optimal
    path parameterisation). Two moving averages over time bound the jerk; they keep the limit on the
    acceleration, and exceed those on the speed a little where these change quickly.

    Args:
        way_m: (N,) increasing distances along the way, from 0.
        limits_m_s: (N,) greatest speed at each, above 0.
        acceleration_m_s2: Greatest acceleration along the way.
        stops: Seconds of rest, above 0, by index into ``way_m``.

    Raises:
        InvalidInputError: It takes longer than `LONGEST_WAY_S`.
    """
    speeds_m_s = _reachable(way_m, limits_m_s, acceleration_m_s2, stops)
    steps_s = 2 * np.diff(way_m) / (speeds_m_s[1:] + speeds_m_s[:-1])
    times_s = np.append(0.0, np.cumsum(steps_s))
    distances_m = way_m
    for index, rest_s in sorted(stops.items(), reverse=True):
        times_s = np.concatenate((times_s[: index + 1], times_s[index:] + rest_s))
        distances_m = np.insert(distances_m, index, distances_m[index])
        speeds_m_s = np.insert(speeds_m_s, index, 0.0)
    if times_s[-1] > LONGEST_WAY_S:
        expected = f"a way of at most {LONGEST_WAY_S:g} s"
        raise InvalidInputError("drive", f"one of {times_s[-1]:.0f} s", expected)
    # Between two places the acceleration is constant, of which the Hermite spline is exact.
    return _smooth(scipy.interpolate.CubicHermiteSpline(times_s, distances_m, speeds_m_s))


def before_and_after(limits_m_s: FloatArray, step_m: float, acceleration_m_s2: float) -> FloatArray:
    """Return limits on the speed that hold as far before and after each place as jerk is bounded.

    Then `distances_over_time` keeps them at the places themselves, too.

    Args:
        limits_m_s: (N,) limits at places with equal distances.
        step_m: Distance of two places.
        acceleration_m_s2: Greatest acceleration along the way.
    """
    reach_m = JERK_TIME_S * (limits_m_s + 2 * JERK_TIME_S * acceleration_m_s2)
    spread = limits_m_s.copy()
    last = min(int(np.ceil(reach_m.max() / step_m)), len(spread) - 1)
    for k in range(1, last + 1):
        near = np.where(reach_m > (k - 1) * step_m, limits_m_s, np.inf)
        spread[k:] = np.minimum(spread[k:], near[:-k])
        spread[:-k] = np.minimum(spread[:-k], near[k:])
    return spread


def _reachable(
    way_m: FloatArray, limits_m_s: FloatArray, acceleration_m_s2: float, stops: Mapping[int, float]
) -> FloatArray:
    """Return the (N,) greatest speeds that the acceleration allows."""
    speeds = limits_m_s.copy()
    speeds[[0, -1, *stops]] = 0.0
    gains = 2 * acceleration_m_s2 * np.diff(way_m)
    for i, gain in enumerate(gains):
        speeds[i + 1] = min(speeds[i + 1], (speeds[i] ** 2 + gain) ** 0.5)
    for i in reversed(range(len(gains))):
        speeds[i] = min(speeds[i], (speeds[i + 1] ** 2 + gains[i]) ** 0.5)
    return speeds


def _smooth(distance_m: PPoly) -> tuple[FloatArray, FloatArray]:
    """Return regular times and the distances at them, averaged over time twice."""
    width = round(JERK_TIME_S / KNOT_INTERVAL_S) // 2 * 2 + 1
    end_s = float(distance_m.x[-1])
    count = int(np.ceil(end_s / KNOT_INTERVAL_S)) + 2 * width
    times_s = np.arange(count) * KNOT_INTERVAL_S
    distances_m = distance_m(np.clip(times_s - width * KNOT_INTERVAL_S, 0.0, end_s))
    for _ in range(2):
        padded = np.pad(distances_m, width // 2, mode="edge")
        distances_m = np.convolve(padded, np.full(width, 1 / width), mode="valid")
    # Rounding must not move the vehicle backwards or beyond the end of its way.
    distances_m = np.maximum.accumulate(distances_m)
    return times_s, np.clip(distances_m, 0.0, float(distance_m(end_s)))
