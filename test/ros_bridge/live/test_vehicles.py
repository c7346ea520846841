"""The live page's vehicles on grounds whose heights are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.geometry import T_LINK_OPTICAL, pose_looking_at, pose_looking_down, pose_to_matrix
from oaisys_ros_bridge.live.vehicles import FIRST_EYE_M, Flight, LiveRover, first_view

EAST = (pose_to_matrix(pose_looking_at((0, 0, 0), (1, 0, 0))) @ T_LINK_OPTICAL)[:3, :3]
NORTH = (pose_to_matrix(pose_looking_at((0, 0, 0), (0, 1, 0))) @ T_LINK_OPTICAL)[:3, :3]


def slope(points_m):
    """The plane z = 0.25 x, without ground west of -20 m."""
    return np.where(points_m[:, 0] < -20, np.nan, 0.25 * points_m[:, 0])


def at(x_m, y_m, z_m, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, (x_m, y_m, z_m)
    return T


def test_a_flight_goes_wherever_it_is_told():
    there = Flight().move(at(1, 2, 3, EAST), np.array((1.0, -1.0, 0.5)), NORTH)
    np.testing.assert_allclose(there, at(2, 1, 3.5, NORTH))


def test_a_rover_climbs_with_the_ground_and_only_along_its_heading():
    there = LiveRover(slope, 1.5).move(at(4, 2, 2.5, EAST), np.array((2.0, 3.0, -1.0)), EAST)
    np.testing.assert_allclose(there[:3, 3], (6.0, 2.0, 0.25 * 6 + 1.5))
    np.testing.assert_allclose(there[:3, :3], EAST, atol=1e-12)  # the mast keeps its pitch


def test_a_rover_rolls_with_a_slope_to_its_side():
    """Heading north, the ground rises to the right: the right of the image (+x) does, too."""
    there = LiveRover(slope, 1.5).move(at(4, 0, 2.5, NORTH), np.zeros(3), NORTH)
    right = np.array((1.0, 0.0, 0.25)) / np.hypot(1.0, 0.25)
    np.testing.assert_allclose(there[:3, 0], right, atol=1e-12)
    np.testing.assert_allclose(there[:3, 2], (0.0, 1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(there[:3, :3].T @ there[:3, :3], np.eye(3), atol=1e-12)


def test_a_rover_refuses_to_leave_the_stage_and_to_climb_cliffs():
    with pytest.raises(InvalidInputError, match=r"rover: received \[-20.0, 0.0\].*the stage"):
        LiveRover(slope, 1.0).move(at(-19, 0, 0, EAST), np.array((-1.0, 0.0, 0.0)), EAST)
    with pytest.raises(InvalidInputError, match="at most 35 degrees; here it is 45"):
        LiveRover(lambda points_m: points_m[:, 1], 1.0).move(at(0, 0, 0, EAST), np.zeros(3), EAST)


WIDE_M = (-50.0, -50.0, 50.0, 50.0)


def test_a_visitor_looks_straight_down_first_only_where_the_start_pose_is_off_the_stage():
    level = pose_to_matrix(pose_looking_at((0, 0, 5), (5, 0, 4))) @ T_LINK_OPTICAL
    np.testing.assert_array_equal(first_view(level, slope, WIDE_M), level)
    down = pose_to_matrix(pose_looking_down(10, 0, 30)) @ T_LINK_OPTICAL
    first = first_view(down, slope, WIDE_M)
    np.testing.assert_allclose(first[:3, 3], (1.0, -6.0, 2.5 + FIRST_EYE_M[2]))
    to_target = np.array((10, 0, 2.5)) - first[:3, 3]
    np.testing.assert_allclose(first[:3, 2], to_target / np.linalg.norm(to_target), atol=1e-12)
    edge = pose_to_matrix(pose_looking_down(-15, 0, 30)) @ T_LINK_OPTICAL
    np.testing.assert_array_equal(first_view(edge, slope, WIDE_M), edge)


def test_a_visitor_of_a_small_stage_looks_from_its_border():
    down = pose_to_matrix(pose_looking_down(0, 0, 30)) @ T_LINK_OPTICAL
    first = first_view(down, slope, (-8.0, -4.0, 8.0, 4.0))
    np.testing.assert_allclose(first[:2, 3], (-7.2, -3.6))
