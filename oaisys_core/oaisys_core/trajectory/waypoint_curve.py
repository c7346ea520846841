"""A smooth curve through waypoints, by its arc length."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import scipy

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray

POINTS_PER_PIECE = 64
"""Points between two waypoints at which the arc length is tabulated."""

MIN_CHORD_M = 1e-3
"""Distance below which two successive waypoints are one; rounding would bend the curve there."""

MIN_SPEED = 1e-6
"""Arc length per unit of the spline's parameter, which is about 1, below which it stands still."""


class WaypointCurve:
    """The natural cubic spline through waypoints in two or three dimensions.

    Attributes:
        length_m: Its length.
        waypoint_arc_m: (K,) arc length at each waypoint.
    """

    def __init__(self, waypoints_m: FloatArray) -> None:
        """Pass through (K, 2) or (K, 3) waypoints, of which successive ones differ.

        Raises:
            InvalidInputError: Two successive waypoints are hardly apart, or the curve reverses.
        """
        chords_m = np.linalg.norm(np.diff(waypoints_m, axis=0), axis=1)
        if len(waypoints_m) < 2:
            raise InvalidInputError(
                "drive.waypoints_m", waypoints_m.tolist(), "two or more waypoints"
            )
        if not (chords_m >= MIN_CHORD_M).all():
            index = int(np.argmin(chords_m >= MIN_CHORD_M)) + 1
            received = f"one {chords_m[index - 1]:.3g} m from the one before"
            expected = f"successive waypoints that are at least {MIN_CHORD_M:g} m apart"
            raise InvalidInputError(f"drive.waypoints_m.{index}", received, expected)
        knots = np.append(0.0, np.cumsum(chords_m))
        self._curve = scipy.interpolate.CubicSpline(knots, waypoints_m, bc_type="natural")
        pieces = [np.linspace(a, b, POINTS_PER_PIECE, endpoint=False) for a, b in pairwise(knots)]
        at = np.append(np.concatenate(pieces), knots[-1])
        arc_m = np.append(0.0, np.cumsum(self._lengths_m(at)))
        speeds = self._speed(at)
        if not speeds.min() > MIN_SPEED:
            place = tuple(self._curve(at[np.argmin(speeds)]).round(3).tolist())
            expected = "a way that does not reverse on the spot"
            raise InvalidInputError("drive.waypoints_m", place, expected)
        self._parameter = scipy.interpolate.CubicHermiteSpline(arc_m, at, 1 / speeds)
        self.length_m = float(arc_m[-1])
        self.waypoint_arc_m: FloatArray = arc_m[::POINTS_PER_PIECE]

    def position_m(self, arc_m: FloatArray) -> FloatArray:
        """Return (N, D) points at (N,) arc lengths."""
        return np.asarray(self._curve(self._parameter(arc_m)))

    def tangent(self, arc_m: FloatArray) -> FloatArray:
        """Return (N, D) unit vectors along the curve."""
        tangent = self._curve(self._parameter(arc_m), 1)
        return np.asarray(tangent / np.linalg.norm(tangent, axis=1, keepdims=True))

    def curvature(self, arc_m: FloatArray) -> FloatArray:
        """Return (N,) curvatures, 1/m."""
        at = self._parameter(arc_m)
        first, second = self._curve(at, 1), self._curve(at, 2)
        speed = np.linalg.norm(first, axis=1)
        along = (first * second).sum(axis=1) / speed**2
        across = second - along[:, None] * first
        return np.asarray(np.linalg.norm(across, axis=1) / speed**2)

    def _speed(self, at: FloatArray) -> FloatArray:
        """Return (N,) arc lengths per unit of the spline's parameter."""
        return np.asarray(np.linalg.norm(self._curve(at, 1), axis=1))

    def _lengths_m(self, at: FloatArray) -> FloatArray:
        """Return the arc lengths between successive parameters, by Gauss' three-point rule."""
        nodes, weights = (-(0.6**0.5), 0.0, 0.6**0.5), np.array((5.0, 8.0, 5.0)) / 9
        middle, half = (at[1:] + at[:-1]) / 2, np.diff(at) / 2
        speeds = [self._speed(middle + node * half) for node in nodes]
        return np.asarray(half * (weights @ np.array(speeds)))
