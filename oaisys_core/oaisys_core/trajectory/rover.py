"""A rover: drives waypoints over the true surface, its attitude from its wheels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from oaisys_core.config.sections.drive import RoverConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.raycast.clearance import HeightLookup
from oaisys_core.trajectory.speed_profile import before_and_after, distances_over_time
from oaisys_core.trajectory.trajectory import Trajectory
from oaisys_core.trajectory.waypoint_curve import WaypointCurve
from oaisys_core.types import FloatArray

STEP_M = 0.05
MAX_STEPS = 100_000
"""Distance between places at which the rover's attitude is found, and their largest number."""

WHEEL_POINTS = 21
WHEEL_ARC_RAD = 1.2
"""Points of the rim that may touch the surface, and the angle from its lowest point to the last."""

ATTITUDE_STEPS = 4
"""Steps of Gauss and Newton from a level attitude to that of the wheels."""

FOOTPRINT_STEP_M = 0.1
"""Distance between points of the footprint at which the surface is compared with the clearance."""

BEND_POINTS = 16
"""Points between two places at which the curvature of the way is evaluated."""

MIN_RADIUS_M = 0.02
"""A way with a tighter curve is refused: the rover does not turn on the spot."""

QUERY_POINTS = 500_000
"""Points of which the height is asked at once."""


@dataclass(frozen=True)
class Obstacle:
    """What blocks a rover's way.

    Attributes:
        position_m: (x, y) in ``map``.
        distance_m: Length of the way to where the rover's footprint first covers it.
        reason: What it is, in words.
    """

    position_m: tuple[float, float]
    distance_m: float
    reason: str

    def __str__(self) -> str:
        x, y = self.position_m
        return f"{self.reason} at ({x:.2f}, {y:.2f}), {self.distance_m:.2f} m along the way"


@dataclass(frozen=True)
class RoverPlan:
    """A rover's drive.

    Attributes:
        trajectory: The motion of ``base_link``, from rest at time 0 to rest.
        obstacle: What it stops in front of; None if it reaches the last waypoint.
    """

    trajectory: Trajectory
    obstacle: Obstacle | None


@dataclass(frozen=True)
class _Attitudes:
    """The rover at N places of its way.

    Attributes:
        arc_m: (N,) horizontal arc lengths.
        xy_m: (N, 2) positions.
        heading: (N, 2) horizontal unit vectors.
        plane: (N, 3) height at the centre and slopes forward and to the left, of the plane on which
            the wheels stand.
    """

    arc_m: FloatArray
    xy_m: FloatArray
    heading: FloatArray
    plane: FloatArray

    def upto(self, count: int) -> _Attitudes:
        """Return the first places."""
        return _Attitudes(
            self.arc_m[:count], self.xy_m[:count], self.heading[:count], self.plane[:count]
        )

    def axes(self) -> FloatArray:
        """Return (N, 3, 3) rotations of ``base_link`` in ``map``."""
        return _axes(self.heading, self.plane[:, 1], self.plane[:, 2])

    def points_m(self, points_base_m: FloatArray) -> FloatArray:
        """Return (N, P, 3) points in ``map`` of (P, 3) points in ``base_link``."""
        origin = np.column_stack((self.xy_m, self.plane[:, 0]))
        return np.asarray(origin[:, None] + points_base_m @ self.axes().transpose(0, 2, 1))


def plan_rover_drive(
    config: RoverConfig, waypoints_m: FloatArray, heights: HeightLookup
) -> RoverPlan:
    """Return the drive through (K, 2) waypoints.

    Args:
        config: The rover.
        waypoints_m: Where its ``base_link`` passes; successive ones differ.
        heights: Looks up ground and topmost surface below (N, 3) points.

    Raises:
        InvalidInputError: The way leaves the stage or turns on the spot, or it is blocked and
            ``on_obstacle`` is ``refuse``, or it is blocked where it begins.
    """
    curve = WaypointCurve(waypoints_m)
    count = int(np.clip(curve.length_m / STEP_M, 32, MAX_STEPS))
    arc_m = np.linspace(0.0, curve.length_m, count + 1)
    bends = _bends(curve, arc_m)
    places = _on_wheels(config, curve, arc_m, heights)
    obstacle = _first_obstacle(config, places, heights)
    if obstacle is not None:
        free = int(np.searchsorted(places.arc_m, obstacle.distance_m)) - 1
        if config.on_obstacle == "refuse" or free < 8:
            expected = f"a way without obstacles ({obstacle})"
            raise InvalidInputError("drive.waypoints_m", waypoints_m.tolist(), expected)
        places = places.upto(free)
    return RoverPlan(_drive_along(config, curve, places, bends[: len(places.arc_m)]), obstacle)


def _bends(curve: WaypointCurve, arc_m: FloatArray) -> FloatArray:
    """Return the (N,) largest curvature between each place and its neighbours, 1/m.

    Raises:
        InvalidInputError: A curve is tighter than `MIN_RADIUS_M`.
    """
    step_m = float(arc_m[1])
    inside_m = arc_m[:-1, None] + step_m * (np.arange(BEND_POINTS) + 0.5) / BEND_POINTS
    heading = curve.tangent(inside_m.ravel())
    # Where the way reverses, the curvature is infinite at a single point; the turn is not.
    turns = np.arccos(np.clip((heading[1:] * heading[:-1]).sum(axis=1), -1.0, 1.0))
    turned = np.append(0.0, turns) * BEND_POINTS / step_m
    bends = np.maximum(turned, curve.curvature(inside_m.ravel())).reshape(inside_m.shape)
    tightest = bends.max(axis=1)
    if not tightest.max() <= 1 / MIN_RADIUS_M:
        x, y = curve.position_m(inside_m[np.argmax(tightest)])[0].tolist()
        expected = f"a way whose curves have radii of at least {MIN_RADIUS_M:g} m"
        raise InvalidInputError("drive.waypoints_m", (round(x, 3), round(y, 3)), expected)
    return np.maximum(np.append(tightest, tightest[-1]), np.append(tightest[0], tightest))


def _on_wheels(
    config: RoverConfig, curve: WaypointCurve, arc_m: FloatArray, heights: HeightLookup
) -> _Attitudes:
    """Place the rover where the rims of its wheels fit best to the surface (least squares)."""
    wheels_m = np.array([(x, y) for x in config.axles_m for y in _sides(config)])
    fit = np.linalg.pinv(np.column_stack((np.ones(len(wheels_m)), wheels_m)))
    rims_m = _rims_m(config, wheels_m)
    xy_m, heading = curve.position_m(arc_m), curve.tangent(arc_m)
    places = _Attitudes(arc_m, xy_m, heading, np.zeros((len(arc_m), 3)))
    for _ in range(ATTITUDE_STEPS):
        points_m = places.points_m(rims_m)
        surface_m, _ = _heights_m(points_m, heights)
        sunk_m = (surface_m - points_m[..., 2]).reshape(len(arc_m), len(wheels_m), -1).max(axis=2)
        places = _Attitudes(arc_m, xy_m, heading, places.plane + sunk_m @ fit.T)
    smooth = _smooth(places.plane, config.suspension_m / float(arc_m[1]))
    return _Attitudes(arc_m, xy_m, heading, smooth)


def _rims_m(config: RoverConfig, wheels_m: FloatArray) -> FloatArray:
    """Return (W * P, 3) points on the lower rims of (W, 2) wheels, in ``base_link``."""
    angles = np.linspace(-WHEEL_ARC_RAD, WHEEL_ARC_RAD, WHEEL_POINTS)
    ahead_m = config.wheel_radius_m * np.sin(angles)
    up_m = config.wheel_radius_m * (1 - np.cos(angles))
    rim_m = np.column_stack((ahead_m, np.zeros(WHEEL_POINTS), up_m))
    centres_m = np.column_stack((wheels_m, np.zeros(len(wheels_m))))
    return np.asarray((centres_m[:, None] + rim_m).reshape(-1, 3))


def _sides(config: RoverConfig) -> tuple[float, float]:
    return (config.track_m / 2, -config.track_m / 2)


def _heights_m(points_m: FloatArray, heights: HeightLookup) -> tuple[FloatArray, FloatArray]:
    """Return heights of the surface and of the ground below points of any shape (..., 3).

    Raises:
        InvalidInputError: A point is off the stage.
    """
    flat = points_m.reshape(-1, 3)
    parts = [
        heights(flat[begin : begin + QUERY_POINTS]) for begin in range(0, len(flat), QUERY_POINTS)
    ]
    surface_m = np.concatenate([part.surface_height_m for part in parts])
    ground_m = np.concatenate([part.ground_height_m for part in parts])
    is_off = np.isnan(surface_m)
    if is_off.any():
        x, y, _ = flat[np.argmax(is_off)].tolist()
        raise InvalidInputError(
            "drive.waypoints_m", (round(x, 3), round(y, 3)), "a way with all wheels on the stage"
        )
    return surface_m.reshape(points_m.shape[:-1]), ground_m.reshape(points_m.shape[:-1])


def _smooth(plane: FloatArray, sigma_steps: float) -> FloatArray:
    """Return heights and slopes, smoothed along the way by a Gaussian."""
    if sigma_steps < 1e-3:
        return plane
    margin = min(int(4 * sigma_steps) + 1, len(plane) - 1)
    # Mirrored at its end points, a steady slope is not changed by the filter, even at its ends.
    padded = np.pad(plane, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = scipy.ndimage.gaussian_filter1d(padded, sigma_steps, axis=0)
    return np.asarray(smooth[margin:-margin])


def _first_obstacle(
    config: RoverConfig, places: _Attitudes, heights: HeightLookup
) -> Obstacle | None:
    """Return what first blocks the way: an object, the ground under the belly, or a slope."""
    found = (_steepest(config, places), _tallest(config, places, heights))
    return min((o for o in found if o is not None), key=lambda o: o.distance_m, default=None)


def _steepest(config: RoverConfig, places: _Attitudes) -> Obstacle | None:
    tilts_deg = np.degrees(_tilts_rad(places))
    is_steep = tilts_deg > config.max_tilt_deg
    if not is_steep.any():
        return None
    i = int(np.argmax(is_steep))
    x, y = places.xy_m[i].tolist()
    reason = f"a tilt of {tilts_deg[i]:.1f} degrees, more than {config.max_tilt_deg:g},"
    return Obstacle((x, y), float(places.arc_m[i]), reason)


def _tallest(config: RoverConfig, places: _Attitudes, heights: HeightLookup) -> Obstacle | None:
    every = max(1, round(FOOTPRINT_STEP_M / float(places.arc_m[1])))
    arc_m = places.arc_m[::every]
    chosen = _Attitudes(arc_m, places.xy_m[::every], places.heading[::every], places.plane[::every])
    points_m = chosen.points_m(_footprint_m(config))
    surface_m, ground_m = _heights_m(points_m, heights)
    above_m = np.maximum(surface_m - ground_m, surface_m - points_m[..., 2])
    is_blocked = (above_m > config.clearance_m).any(axis=1)
    if not is_blocked.any():
        return None
    i = int(np.argmax(is_blocked))
    j = int(np.argmax(above_m[i]))
    x, y = points_m[i, j, :2].tolist()
    kind = "an object" if surface_m[i, j] - ground_m[i, j] > config.clearance_m else "ground"
    reason = f"{kind} {above_m[i, j]:.2f} m high, more than {config.clearance_m:g} m,"
    return Obstacle((x, y), float(arc_m[i]), reason)


def _footprint_m(config: RoverConfig) -> FloatArray:
    """Return (P, 3) points of the plane below the rover, in ``base_link``."""
    front_m = max(config.axles_m) + config.wheel_radius_m
    back_m = min(config.axles_m) - config.wheel_radius_m
    along = _space(back_m, front_m)
    across = _space(*sorted(_sides(config)))
    x, y = np.meshgrid(along, across)
    return np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))


def _space(low_m: float, high_m: float) -> FloatArray:
    return np.linspace(low_m, high_m, int(np.ceil((high_m - low_m) / FOOTPRINT_STEP_M)) + 1)


def _drive_along(
    config: RoverConfig, curve: WaypointCurve, places: _Attitudes, bends: FloatArray
) -> Trajectory:
    """Return the drive along the places, as fast as slopes and curves allow."""
    from scipy.spatial.transform import Rotation

    arc_m = places.arc_m
    rise_m = np.diff(places.plane[:, 0])
    way_m = np.append(0.0, np.cumsum(np.hypot(np.diff(arc_m), rise_m)))
    share = np.minimum(_tilts_rad(places) / np.radians(config.max_tilt_deg), 1.0)
    slow_m_s = config.speed_m_s * (1 - (1 - config.slowest_share) * share)
    bends = np.maximum(bends, 1e-9)
    turning_m_s = np.radians(config.turn_rate_deg_s) / bends
    curved_m_s = np.minimum(turning_m_s, np.sqrt(config.acceleration_m_s2 / bends))
    curved_m_s = np.minimum(curved_m_s, config.speed_m_s)
    curved_m_s = before_and_after(curved_m_s, float(arc_m[1]), config.acceleration_m_s2)
    limits_m_s = np.minimum(slow_m_s, curved_m_s)
    times_s, driven_m = distances_over_time(way_m, limits_m_s, config.acceleration_m_s2, {})
    at_m = np.clip(scipy.interpolate.CubicSpline(way_m, arc_m)(driven_m), 0.0, arc_m[-1])
    plane = scipy.interpolate.CubicSpline(arc_m, places.plane)(at_m)
    there = _Attitudes(at_m, curve.position_m(at_m), curve.tangent(at_m), plane)
    positions_m = np.column_stack((there.xy_m, plane[:, 0]))
    quats_xyzw = Rotation.from_matrix(there.axes()).as_quat()
    return Trajectory(times_s, positions_m, quats_xyzw)


def _tilts_rad(places: _Attitudes) -> FloatArray:
    """Return (N,) angles between the rover's z axis and the vertical."""
    return np.asarray(np.arctan(np.hypot(places.plane[:, 1], places.plane[:, 2])))


def _axes(heading: FloatArray, forward: FloatArray, left: FloatArray) -> FloatArray:
    """Return (N, 3, 3) rotations: x along the heading, in the plane with these slopes."""
    ahead = np.column_stack((heading, forward))
    sideways = np.column_stack((-heading[:, 1], heading[:, 0], left))
    x = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    z = np.cross(ahead, sideways)
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    return np.stack((x, np.cross(z, x), z), axis=-1)
