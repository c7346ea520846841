"""Ice, lava, rivers and debris, against what is known of their shapes."""

from __future__ import annotations

import numpy as np
import pytest

from oaisys_core.procedural.terrain.processes.debris import drop_debris, run_out
from oaisys_core.procedural.terrain.processes.exact import tangent
from oaisys_core.procedural.terrain.processes.flow import route
from oaisys_core.procedural.terrain.processes.ice import moraine, troughs_around
from oaisys_core.procedural.terrain.processes.lava import LavaFlow, cinder_cone, emplace
from oaisys_core.procedural.terrain.processes.river import (
    blocks_near,
    channel_depth,
    channel_of,
    curvature,
    cut_off,
    even,
    wander,
)


def test_a_trough_is_a_parabola_in_any_direction() -> None:
    floor = np.full((81, 81), np.inf)
    diagonal = np.arange(81)
    floor[diagonal, diagonal] = 5.0
    trough = troughs_around(floor, 2.0, half_width_m=30.0, depth_m=12.0)
    row, col = np.mgrid[:81, :81]
    distance_m = 2.0 * np.abs(row - col) / np.sqrt(2)
    near = (distance_m < 25) & (row > 20) & (row < 60) & (col > 20) & (col < 60)
    parabola = 5.0 + 12.0 * (distance_m / 30.0) ** 2
    assert trough.surface_m[near] == pytest.approx(parabola[near], abs=0.05)
    assert (trough.floor_m[near] == 5.0).all()


def test_a_moraine_crosses_the_floor_where_the_ice_ended() -> None:
    x, across = np.arange(200.0), np.abs(np.arange(-40.0, 41.0))[:, None]
    floor_m = np.broadcast_to(0.2 * x, (81, 200))
    z = floor_m + 0.01 * across**2
    ridge = moraine(z, floor_m, end_m=12.0, head_m=40.0, thickness_m=8.0, height_m=2.0)
    assert ridge.max() <= 2.0
    crest = np.argmax(ridge[40])
    assert x[crest] == pytest.approx(60.0, abs=8.0), "an end moraine at the height of the end"
    assert ridge[40, 100:].max() == 0.0, "none on the floor below the ice"
    assert ridge[:, 80].max() > 0.5, "lateral ones on the sides"


def test_cones_of_cinder_stand_at_the_angle_of_repose() -> None:
    x = np.linspace(-100, 100, 401)
    cone = cinder_cone(x, np.zeros(401), height_m=20.0, repose=tangent(32.0), crater=0.35)
    slope = np.degrees(np.arctan(np.abs(np.gradient(cone, x))))
    assert slope.max() == pytest.approx(32.0, abs=0.5)
    assert cone[200] < cone.max() - 5.0, "there is a crater"
    rim, base = np.abs(x[np.argmax(cone)]), 20.0 / tangent(32.0) / 0.65
    assert rim / base == pytest.approx(0.35, abs=0.03)


def test_lava_runs_downhill_and_is_as_much_as_came_out() -> None:
    z = np.tile(0.1 * np.arange(129.0), (129, 1))
    flow = LavaFlow((64.0, 64.0), lobes=150, radius_m=4.0, thickness_m=0.5)
    after = emplace(z, 1.0, flow, np.random.default_rng(0))
    assert after.elevation_m - z == pytest.approx(after.lava_m)
    columns = np.arange(129.0)
    mean_x = (after.lava_m.sum(axis=0) * columns).sum() / after.lava_m.sum()
    assert mean_x < 55.0, "towards lower x"
    assert (after.reached[after.lava_m > 0] > 0).all()


def test_debris_comes_to_rest_or_leaves_and_lies_at_its_angle() -> None:
    rng = np.random.default_rng(0)
    z = np.tile(np.where(np.arange(96) < 40, 30.0, 0.0), (48, 1)) + rng.uniform(0, 0.1, (48, 96))
    amount = np.zeros_like(z)
    amount[:, 38:41] = 0.5
    rest = run_out(z, route(z, 1.0, rng), amount, tangent(35.0))
    assert (rest >= 0).all()
    assert 0 < rest.sum() <= amount.sum() + 1e-9
    after, debris = drop_debris(
        z, 1.0, rng, rock=tangent(60.0), repose=tangent(35.0), amount_m=3.0, rounds=6
    )
    assert debris[:, 40:60].sum() > 0.8 * debris.sum(), "at the foot of the wall"
    assert after.sum() <= z.sum() + 1e-6


def test_a_bend_turns_as_its_circle() -> None:
    angle = np.linspace(0, np.pi, 400)
    circle = 50.0 * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    assert curvature(circle)[5:-5] == pytest.approx(np.full(390, 1 / 50.0), rel=1e-3)
    assert curvature(circle[::-1])[5:-5] == pytest.approx(np.full(390, -1 / 50.0), rel=1e-3)


def test_bends_grow_and_necks_are_cut_off() -> None:
    x = np.linspace(0, 400, 200)
    line = even(np.stack((x, 3.0 * np.sin(2 * np.pi * x / 110)), axis=1), 3.5)
    before = np.ptp(line[:, 1])
    for _ in range(60):
        line = wander(line, 10.0, 0.1)
    assert np.ptp(line[:, 1]) > 1.5 * before
    angle = np.linspace(0.05, 2 * np.pi - 0.05, 120)
    loop = 40.0 * np.stack((np.sin(angle), 1 - np.cos(angle)), axis=1)
    way = np.concatenate(([[-60.0, 0.0], [-30.0, 0.0]], loop, [[30.0, 0.0], [60.0, 0.0]]))
    assert np.ptp(cut_off(even(way, 3.5), 10.0)[:, 1]) < 12.0


def test_a_bed_is_deepest_at_the_outer_side_of_a_bend() -> None:
    angle = np.linspace(0, np.pi, 200)
    line = 40.0 * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    y = np.linspace(36.0, 44.0, 41)[:, None]
    channel = channel_of(line, 10.0, np.zeros_like(y), y)
    depth = channel_depth(channel, 0.5)[:, 0]
    # The circle runs counter-clockwise: its outer side is away from the origin.
    assert np.argmax(depth) > 25
    assert channel.across[:, 0] == pytest.approx((40.0 - y[:, 0]) / 5.0, abs=0.02)


def test_blocks_near_a_line_hold_all_places_within_reach_and_few_others() -> None:
    line = even(np.array([[-30.0, -8.0], [0.0, 5.0], [30.0, -2.0]]), 0.5)
    axis = np.linspace(-20.0, 20.0, 101)
    x, y = 0.8 * axis[None, :] + 0.6 * axis[:, None], 0.8 * axis[:, None] - 0.6 * axis[None, :]
    distance = np.hypot(x[..., None] - line[:, 0], y[..., None] - line[:, 1]).min(axis=-1)
    near = blocks_near(line, 3.0, x, y)
    assert near[distance <= 3.0].all()
    assert not near[distance > 3.0 + 2 * 8 * 0.4 * 1.42].any()
