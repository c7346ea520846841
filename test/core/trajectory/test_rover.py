"""Rovers: attitude from the wheels against closed forms, speed by slope, and what blocks them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.config.sections.drive import RoverConfig
from oaisys_core.errors import InvalidInputError
from oaisys_core.simulation import Simulation
from oaisys_core.trajectory import Trajectory
from oaisys_core.trajectory.rover import RoverPlan, plan_rover_drive
from oaisys_core.types import FloatArray, HeightQuery

Surface = Callable[[FloatArray, FloatArray], FloatArray]

STRAIGHT_M: FloatArray = np.array([(0.0, 0.0), (20.0, 0.0)])
ROUND_M: FloatArray = np.array([(0, 0), (8, 2), (14, 9), (8, 15), (0, 12)], float)


def planned(
    ground: Surface, waypoints_m: FloatArray, rocks: Surface | None = None, **keys: object
) -> RoverPlan:
    def heights(points_m: FloatArray) -> HeightQuery:
        x, y = points_m[:, 0], points_m[:, 1]
        ground_m = ground(x, y)
        surface_m = ground_m if rocks is None else ground_m + rocks(x, y)
        return HeightQuery(ground_m, surface_m, points_m[:, 2] - surface_m)

    return plan_rover_drive(RoverConfig.model_validate(keys), waypoints_m, heights)


def tilted(x: FloatArray, y: FloatArray) -> FloatArray:
    return 0.25 * x - 0.15 * y + 3.0


def level(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.zeros(len(x))


def ramp(slope: float, x: FloatArray, y: FloatArray) -> FloatArray:
    return slope * x


def waves(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(0.4 * np.sin(0.5 * x) + 0.3 * np.cos(0.4 * y))


def dome(x0: float, y0: float, height_m: float) -> Surface:
    """A half ellipsoid of 0.4 m radius."""
    return lambda x, y: np.asarray(
        height_m * np.sqrt(np.maximum(0, 1 - ((x - x0) ** 2 + (y - y0) ** 2) / 0.4**2))
    )


def wheels_m(trajectory: Trajectory, config: RoverConfig) -> FloatArray:
    """Return (N, W, 3) centres of the wheels."""
    T = trajectory.T_map_base(trajectory.times_s)
    y = config.track_m / 2
    centres = [(x, side, config.wheel_radius_m) for x in config.axles_m for side in (y, -y)]
    return np.asarray(T[:, None, :3, 3] + np.array(centres) @ T[:, :3, :3].transpose(0, 2, 1))


def test_on_a_plane_a_rover_stands_on_its_wheels_with_the_planes_normal() -> None:
    made = planned(tilted, ROUND_M).trajectory
    R = made.rotation(made.times_s).as_matrix()
    normal = np.array((-0.25, 0.15, 1.0)) / np.linalg.norm((-0.25, 0.15, 1.0))
    assert R[..., 2] == pytest.approx(np.tile(normal, (len(R), 1)), abs=5e-4)
    x, y, z = made.position_m(made.times_s).T
    assert z == pytest.approx(tilted(x, y), abs=1e-3)
    velocity = made.velocity_m_s(made.times_s)
    is_moving = np.linalg.norm(velocity, axis=1) > 0.3
    forward = velocity[is_moving] / np.linalg.norm(velocity[is_moving], axis=1, keepdims=True)
    assert R[is_moving, :, 0] == pytest.approx(forward, abs=5e-3)


def test_on_waves_its_wheels_touch_the_ground() -> None:
    made = planned(waves, ROUND_M, suspension_m=0).trajectory
    x, y, z = np.moveaxis(wheels_m(made, RoverConfig()), -1, 0)
    slope = np.hypot(0.2 * np.cos(0.5 * x), 0.12 * np.sin(0.4 * y))
    gap_m = z - waves(x, y) - RoverConfig().wheel_radius_m * np.sqrt(1 + slope**2)
    assert np.abs(gap_m.mean(axis=1)).max() < 3e-3
    # Six wheels on a rigid frame do not all touch curved ground: the frame lies between them.
    assert np.abs(gap_m).max() < 0.06


def test_it_drives_through_its_waypoints_and_slows_down_on_slopes() -> None:
    made = planned(waves, ROUND_M).trajectory
    positions_m = made.position_m(np.linspace(made.start_s, made.end_s, 5001))
    for waypoint_m in ROUND_M:
        assert np.linalg.norm(positions_m[:, :2] - waypoint_m, axis=1).min() < 0.02
    speeds = {}
    for slope in (0.0, 0.2, 0.4):
        climb = planned(partial(ramp, slope), STRAIGHT_M).trajectory
        speed = np.linalg.norm(climb.velocity_m_s(climb.times_s), axis=1)
        speeds[slope] = speed.max()
        expected = 1 - 0.7 * np.degrees(np.arctan(slope)) / 30
        assert speeds[slope] == pytest.approx(expected, rel=0.01)
        assert np.linalg.norm(climb.acceleration_m_s2(climb.times_s), axis=1).max() < 0.5 * 1.05


def test_a_rock_lower_than_the_clearance_lifts_the_wheel_that_rolls_over_it() -> None:
    made = planned(level, STRAIGHT_M, dome(10.0, 0.72, 0.2)).trajectory
    x, _, z = made.position_m(made.times_s).T
    roll = made.rotation(made.times_s).as_euler("ZYX")[:, 2]
    over = int(np.argmin(np.abs(x - 10)))
    assert z[over] > 0.02
    assert roll[over] > 0.01  # the left side is up
    assert np.abs(z[x < 7]).max() < 1e-3


@pytest.mark.parametrize("y_m", [0.0, 0.72, -0.6])
def test_a_rock_taller_than_the_clearance_blocks_the_way(y_m: float) -> None:
    with pytest.raises(
        InvalidInputError, match=r"an object 0\.[34]\d m high.* at \(1\d\.\d"
    ) as got:
        planned(level, STRAIGHT_M, dome(12.0, y_m, 0.4))
    assert got.value.field == "drive.waypoints_m"
    plan = planned(level, STRAIGHT_M, dome(12.0, y_m, 0.4), on_obstacle="stop")
    assert plan.obstacle is not None
    assert plan.obstacle.position_m == pytest.approx((12.0, y_m), abs=0.4)
    end_m = plan.trajectory.position_m(plan.trajectory.end_s)[0]
    front_m = end_m[0] + 0.85 + 0.25
    assert 11.0 < front_m < 11.8
    assert np.linalg.norm(plan.trajectory.velocity_m_s(plan.trajectory.end_s)) < 1e-3


def test_a_rock_beside_the_way_does_not_block_it() -> None:
    assert planned(level, STRAIGHT_M, dome(12.0, 1.5, 0.9)).obstacle is None


def test_a_ridge_under_the_belly_and_a_steep_slope_block_the_way() -> None:
    with pytest.raises(InvalidInputError, match=r"ground 0\.[345]"):
        planned(lambda x, y: 0.5 * np.exp(-(((x - 10) / 0.25) ** 2)), STRAIGHT_M)
    with pytest.raises(InvalidInputError, match=r"a tilt of 3\d\.\d degrees, more than 30"):
        planned(lambda x, y: 0.05 * np.maximum(x - 5, 0) ** 2, STRAIGHT_M)


def test_a_way_that_leaves_the_stage_or_begins_on_a_rock_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="all wheels on the stage"):
        planned(lambda x, y: np.where(x < 15, 0.0, np.nan), STRAIGHT_M)
    with pytest.raises(InvalidInputError, match=r"0\.00 m along the way"):
        planned(level, STRAIGHT_M, dome(0.5, 0.0, 0.8), on_obstacle="stop")


def test_on_a_world_it_follows_the_surface_that_cameras_see() -> None:
    simulation = Simulation(
        config_from_mapping(
            {
                "backend": "analytic",
                "stage": {
                    "surroundings": "plain",
                    "preset": "mounds",
                    "extent_m": 40,
                    "resolution_px": 129,
                },
                "materials": {"texture_size_px": 16, "mask": {"size_px": 16}},
                "assets": {
                    "rocks": [{"kind": "rounded", "count": [200, 200], "size_m": [0.2, 0.2]}]
                },
            }
        )
    )
    simulation.step_batch()
    config = RoverConfig()
    made = plan_rover_drive(config, ROUND_M - 6, simulation.query_height).trajectory
    centres_m = wheels_m(made, config)
    below = simulation.query_height(centres_m.reshape(-1, 3)).clearance_m
    gap_m = below.reshape(centres_m.shape[:2]) - config.wheel_radius_m
    assert np.abs(gap_m.mean(axis=1)).max() < 0.06
    assert np.ptp(made.position_m(made.times_s)[:, 2]) > 0.1
    simulation.close()


@pytest.mark.parametrize("rate_deg_s", [45.0, 10.0])
def test_a_rover_turns_its_heading_no_faster_than_its_turn_rate(rate_deg_s: float) -> None:
    corner = np.array([(0, 0), (3, 0), (3.2, 0.4), (2.9, 0.6), (0, 1)], float)
    made = planned(level, corner, turn_rate_deg_s=rate_deg_s, speed_m_s=2.0).trajectory
    times_s = np.linspace(made.start_s, made.end_s, 20_001)
    rates_deg_s = np.degrees(np.abs(made.angular_rate_rad_s(times_s)[:, 2]))
    assert rates_deg_s.max() <= 1.02 * rate_deg_s
    if rate_deg_s == 10.0:  # here, that is what limits the speed
        assert rates_deg_s.max() >= 0.8 * rate_deg_s
    limit = np.radians(rate_deg_s) / 0.05
    assert np.linalg.norm(made.acceleration_m_s2(times_s), axis=1).max() < limit


@pytest.mark.parametrize(
    ("end_m", "expected"), [(0.0, "does not reverse"), (1e-3, "radii of at least 0.02 m")]
)
def test_a_way_that_reverses_on_the_spot_is_refused(end_m: float, expected: str) -> None:
    with pytest.raises(
        InvalidInputError, match=rf"drive.waypoints_m: .*0.0\), expected.*{expected}"
    ):
        planned(level, np.array([(0, 0), (2, 0), (0, end_m)], float))
