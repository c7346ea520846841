"""Where broken rock lies, on grounds of a closed form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.procedural.scatter.placement.walls import (
    INSIDE,
    OUTSIDE,
    SIZES_M,
    place_on_walls,
)
from oaisys_core.scene import HeightField, PbrMaps, TerrainLayer, TerrainMaterial
from oaisys_core.types import FloatArray

HALF_M, POINTS = 30.0, 301
HEIGHT_M = 24.0


def maps() -> PbrMaps:
    pixels = np.full((4, 4, 3), 120, np.uint8)
    flat = np.full((4, 4), 0.5, np.float32)
    return PbrMaps("plain", pixels, flat, pixels, np.full((4, 4), 200, np.uint8), 1.0)


def wall_height_m(x_m: FloatArray, slope_deg: float) -> FloatArray:
    """A plain, a plane slope of `HEIGHT_M` that rises to +x, and a plain."""
    rise = np.tan(np.radians(slope_deg))
    return np.clip(x_m * rise + HEIGHT_M / 2, 0, HEIGHT_M)


def wall(slope_deg: float) -> HeightField:
    x = np.linspace(-HALF_M, HALF_M, POINTS)
    heights = np.tile(wall_height_m(x, slope_deg), (POINTS, 1)).astype(np.float32)
    return HeightField(heights, (-HALF_M, -HALF_M), 2 * HALF_M / (POINTS - 1))


def material(masks: NDArray[np.float32]) -> TerrainMaterial:
    layers = tuple(TerrainLayer(f"l{n}", (n + 1,), maps()) for n in range(len(masks)))
    return TerrainMaterial(layers, masks, (-HALF_M, -HALF_M, HALF_M, HALF_M))


def poses(slope_deg: float, layer: int = 0, masks: NDArray[np.float32] | None = None) -> FloatArray:
    masks = np.ones((1, 256, 256), np.float32) if masks is None else masks
    rng = np.random.default_rng(3)
    return place_on_walls(layer, material(masks), wall(slope_deg), rng)


@pytest.mark.parametrize("slope_deg", [45.0, 60.0, 75.0, 84.0])
def test_pieces_lie_in_the_wall_upright_with_their_rims_in_the_rock(slope_deg: float) -> None:
    T = poses(slope_deg)
    assert len(T) > 50
    sizes_m = np.linalg.norm(T[:, :3, 0], axis=1)
    assert sizes_m.min() >= SIZES_M[0] - 1e-9
    assert sizes_m.max() <= SIZES_M[1] + 1e-9
    axes = T[:, :3, :3] / sizes_m[:, None, None]
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, atol=1e-9)
    np.testing.assert_allclose(axes[:, 2, 0], 0.0, atol=1e-12)
    assert axes[:, 2, 1].min() > 0.5
    # Out of the wall, which rises to +x. Cells at its ends hold less of the slope.
    out = np.array((-np.sin(np.radians(slope_deg)), 0.0, np.cos(np.radians(slope_deg))))
    assert np.median(axes[:, :, 2] @ out) > np.cos(np.radians(6.0))
    middle_m = T[:, :3, 3]
    cell_m = 2 * HALF_M / (POINTS - 1)
    # Within a cell, the triangles of the grid cut the corners at the foot and the rim.
    lowest = wall_height_m(middle_m[:, 0] - cell_m, slope_deg)
    highest = wall_height_m(middle_m[:, 0] + cell_m, slope_deg)
    assert ((middle_m[:, 2] >= lowest - 1e-6) & (middle_m[:, 2] <= highest + 1e-6)).all()
    for far, deep in INSIDE:
        for angle in np.radians(np.arange(0, 360, 22.5)):
            point = np.array((far * np.cos(angle), far * np.sin(angle), -deep, 1.0))
            at = (T @ point)[:, :3]
            above = wall_height_m(at[:, 0] + cell_m, slope_deg)
            assert (at[:, 2] <= above + 1e-6).all()
    for angle in np.radians(np.arange(0, 360, 22.5)):
        far, out_by = OUTSIDE
        point = np.array((far * np.cos(angle), far * np.sin(angle), out_by, 1.0))
        at = (T @ point)[:, :3]
        assert (at[:, 2] >= wall_height_m(at[:, 0] - cell_m, slope_deg) - 1e-6).all()


def test_they_cover_most_of_a_plane_wall() -> None:
    slope_deg = 70.0
    T = poses(slope_deg)
    up_m = T[:, 2, 3] / np.sin(np.radians(slope_deg))
    places = np.column_stack((T[:, 1, 3], up_m))
    reach_m = 0.4 * np.linalg.norm(T[:, :3, 0], axis=1)
    length_m = HEIGHT_M / np.sin(np.radians(slope_deg))
    rng = np.random.default_rng(0)
    # Away from the ends, where pieces must not stand into the air.
    drawn = rng.uniform((-25.0, 3.0), (25.0, length_m - 3.0), (2000, 2))
    away_m = np.linalg.norm(drawn[:, None] - places, axis=-1)
    assert (away_m < reach_m).any(axis=1).mean() > 0.75


@pytest.mark.parametrize("slope_deg", [0.0, 20.0, 28.0])
def test_gentle_ground_has_none(slope_deg: float) -> None:
    assert len(poses(slope_deg)) == 0


def test_only_walls_of_the_layer_have_them() -> None:
    masks = np.zeros((2, 256, 256), np.float32)
    masks[0, :128] = 1.0
    masks[1, 128:] = 1.0
    for layer, sign in ((0, -1), (1, 1)):
        y_m = poses(70.0, layer, masks)[:, 1, 3]
        assert len(y_m) > 20
        assert (sign * y_m).min() > -2 * HALF_M / 256


def test_the_same_seed_draws_the_same_pieces() -> None:
    assert poses(70.0).tobytes() == poses(70.0).tobytes()
