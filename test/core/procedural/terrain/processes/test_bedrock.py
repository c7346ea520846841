"""Bedrock: steep rock is broken into blocks, soil is not, and debris lies below walls."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from oaisys_core.procedural.terrain.processes.bedrock import bend_to_joints, break_rock, lay_talus
from oaisys_core.types import FloatArray

SPACING_M = 0.1


def ramp(slope: float, size_px: int = 201) -> FloatArray:
    return np.tile(slope * SPACING_M * np.arange(size_px), (size_px, 1))


def slopes_deg(z: FloatArray) -> FloatArray:
    return np.degrees(np.arctan(np.hypot(*np.gradient(z, SPACING_M))))


def test_steep_rock_has_faces_and_treads_where_the_slope_was_even() -> None:
    before = ramp(1.2)
    after = break_rock(before, SPACING_M, 2.0, np.random.default_rng(1))
    slope = slopes_deg(after)
    assert (slope > 65).mean() > 0.03, "faces"
    assert (slope < 45).mean() > 0.2, "treads"
    assert np.abs(after - before).max() < 2.0
    assert (after - before).mean() == pytest.approx(0.0, abs=0.1)


def test_gentle_ground_stays_as_it_is() -> None:
    before = ramp(0.05)
    after = break_rock(before, SPACING_M, 2.0, np.random.default_rng(1))
    assert (np.abs(after - before) < 0.01).mean() > 0.95


def test_blocks_too_small_for_the_grid_are_left_out() -> None:
    before = ramp(1.2, 65)
    for block_m in (0.0, 3 * SPACING_M):
        after = break_rock(before, SPACING_M, block_m, np.random.default_rng(1))
        np.testing.assert_array_equal(after, before)
        np.testing.assert_array_equal(
            lay_talus(before, SPACING_M, block_m, np.random.default_rng(1)), before
        )


def test_debris_lies_at_the_foot_of_a_wall_at_its_angle_of_repose() -> None:
    before = np.zeros((201, 201))
    before[:, 120:] = 4.0
    after = lay_talus(before, SPACING_M, 4.0, np.random.default_rng(2))
    np.testing.assert_array_equal(after[:, :60], before[:, :60])
    np.testing.assert_allclose(after[:, 130:], 4.0, atol=0.001)
    height_m = after[20:-20, 117]
    assert 0.2 < height_m.min() < height_m.max() < 3.2
    assert height_m.std() > 0.15, "cones, and gaps between them"
    slope = slopes_deg(after)[20:-20, 90:115]
    assert 28 < np.median(slope[slope > 5]) < 38


def test_lines_of_equal_values_bend_to_joints() -> None:
    field = ramp(1.0)
    bent = bend_to_joints(field, SPACING_M, 2.0, np.random.default_rng(3))
    assert bent.mean() == pytest.approx(field.mean(), rel=1e-4)
    across = np.abs(np.diff(bent, axis=0))
    assert (across < 1e-9).mean() > 0.7, "straight within a block, but for its faces"
    assert across.max() > 0.1, "steps at joints"


def test_rock_and_debris_have_the_same_bytes_on_each_python() -> None:
    rng = np.random.default_rng(4)
    broken = break_rock(ramp(1.2, 129), SPACING_M, 2.0, rng)
    broken[:, 70:] += 3.0
    laid = lay_talus(broken, SPACING_M, 3.0, rng).astype(np.float32)
    assert hashlib.sha256(laid.tobytes()).hexdigest()[:16] == "343a97206e2fe9fd"


def test_faces_oblique_to_the_grid_have_none_of_its_steps() -> None:
    before = ramp(1.2)
    after = break_rock(before, SPACING_M, 2.0, np.random.default_rng(1))
    # Along a wall with the steps of the grid, every cell or two would rise and fall.
    sideways = np.diff(after - before, axis=0)
    turns = (sideways[1:] * sideways[:-1] < 0) & (np.abs(np.diff(sideways, axis=0)) > 0.25)
    assert turns.mean() < 0.001
