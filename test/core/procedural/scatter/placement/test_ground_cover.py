"""Where the grass of a layer stands, and how it looks."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.color import linear
from oaisys_core.procedural.scatter.placement.ground_cover import (
    MOST_PLACES,
    TONES,
    cover_places,
    cover_poses,
    tones_at,
)
from oaisys_core.procedural.scatter.plants.swards import (
    SWARDS,
    Tuft,
    blade_color,
    make_tuft,
)
from oaisys_core.scene import HeightField, PbrMaps, TerrainLayer, TerrainMaterial

EDGE_M = 20.0


def ground(extent_m: float = EDGE_M, slope: float = 0.0) -> HeightField:
    half_m, count = extent_m / 2, 65
    x = np.linspace(-half_m, half_m, count)
    heights = np.tile(slope * x, (count, 1)).astype(np.float32)
    return HeightField(heights, (-half_m, -half_m), extent_m / (count - 1))


def maps(color: tuple[int, int, int]) -> PbrMaps:
    pixels = np.full((16, 16, 3), color, np.uint8)
    flat = np.full((16, 16), 0.5, np.float32)
    return PbrMaps("plain", pixels, flat, pixels, np.full((16, 16), 200, np.uint8), 1.0)


def material(mask: NDArray[np.float32], extent_m: float = EDGE_M) -> TerrainMaterial:
    half_m = extent_m / 2
    layers = (
        TerrainLayer("turf", (1,), maps((90, 110, 60)), sward="turf"),
        TerrainLayer("soil", (2,), maps((140, 110, 80))),
    )
    masks = np.stack((mask, 1 - mask)).astype(np.float32)
    return TerrainMaterial(layers, masks, (-half_m, -half_m, half_m, half_m))


def left_half() -> NDArray[np.float32]:
    mask = np.zeros((200, 200), np.float32)
    mask[:, :100] = 1
    return mask


def patch() -> Tuft:
    return SWARDS["turf"][0]


def test_tufts_stand_on_the_layer_alone() -> None:
    found = cover_places(patch(), 0, material(left_half()), ground(), np.random.default_rng(1))
    assert len(found.xy_m) > 500
    assert found.xy_m[:, 0].max() <= 0.0
    assert found.xy_m.min() >= -EDGE_M / 2


def test_tufts_are_fewer_and_smaller_at_the_edge_of_a_layer() -> None:
    found = cover_places(patch(), 0, material(left_half()), ground(), np.random.default_rng(2))
    x = found.xy_m[:, 0]
    edge, middle = x > -0.2, (x < -4) & (x > -6)
    assert edge.sum() / 0.2 < 0.75 * middle.sum() / 2
    assert found.sizes_m[edge].mean() < 0.9 * found.sizes_m[middle].mean()


def test_a_layer_that_covers_all_has_as_many_tufts_as_it_says() -> None:
    whole = np.ones((200, 200), np.float32)
    tuft = patch()._replace(clumping=0.0)
    found = cover_places(tuft, 0, material(whole), ground(), np.random.default_rng(3))
    assert len(found.xy_m) <= tuft.per_m2 * EDGE_M**2
    assert len(found.xy_m) > 0.6 * tuft.per_m2 * EDGE_M**2


def test_large_stages_have_fewer_and_larger_tufts() -> None:
    whole, extent_m = np.ones((64, 64), np.float32), 400.0
    found = cover_places(
        patch(), 0, material(whole, extent_m), ground(extent_m), np.random.default_rng(4)
    )
    small = cover_places(patch(), 0, material(whole), ground(), np.random.default_rng(4))
    assert len(found.xy_m) <= MOST_PLACES
    assert found.sizes_m.mean() > 1.3 * small.sizes_m.mean()


def test_no_tufts_stand_in_water_or_on_walls() -> None:
    whole, rng = np.ones((64, 64), np.float32), np.random.default_rng(5)
    found = cover_places(patch(), 0, material(whole), ground(slope=0.1), rng, water_m=0.0)
    assert len(found.xy_m) > 100
    assert found.xy_m[:, 0].min() > 0.0
    assert not len(cover_places(patch(), 0, material(whole), ground(slope=2.0), rng).xy_m)


def test_a_layer_without_ground_has_no_tufts() -> None:
    nothing = np.zeros((64, 64), np.float32)
    found = cover_places(patch(), 0, material(nothing), ground(), np.random.default_rng(6))
    assert found.xy_m.shape == (0, 2)
    assert cover_poses(ground(), found.xy_m, found.sizes_m, np.random.default_rng(6)).shape == (
        0,
        4,
        4,
    )


def test_tufts_stand_on_the_ground_along_its_normal() -> None:
    slope = 0.5
    xy_m = np.random.default_rng(7).uniform(-5, 5, (50, 2))
    poses = cover_poses(ground(slope=slope), xy_m, np.full(50, 0.6), np.random.default_rng(7))
    np.testing.assert_allclose(poses[:, 2, 3], slope * xy_m[:, 0], atol=0.01)
    up = poses[:, :3, 2] / 0.6
    expected = np.array((-slope, 0, 1)) / np.hypot(slope, 1)
    np.testing.assert_allclose(up, np.tile(expected, (50, 1)), atol=1e-3)


def test_ground_without_a_tone_has_one() -> None:
    tone, factors = tones_at(material(left_half()), np.zeros((5, 2)))
    assert not tone.any()
    np.testing.assert_array_equal(factors, np.ones((TONES, 3)))


@pytest.mark.parametrize("name", SWARDS)
def test_blades_are_millimetres_wide_and_of_the_textures_colour(name: str) -> None:
    for tuft in SWARDS[name]:
        color = blade_color(maps((90, 110, 60)))
        shape = make_tuft("grass", tuft, color, np.random.default_rng(8))
        size_m = float(np.mean(tuft.width_m))
        assert np.ptp(shape.vertices_m, axis=0).max() == pytest.approx(1.0)
        # No blade of a lawn is higher than a hand, and none of a meadow than a knee.
        assert 0.02 < size_m * np.ptp(shape.vertices_m[:, 2]) < 0.45
        assert tuft.blade_m[1] <= 0.005
        assert shape.vertex_colors_srgb is not None
        mean = linear(shape.vertex_colors_srgb / 255).mean(axis=0)
        # Green as the texture or a little drier: neither neon nor straw.
        assert 1.1 < mean[1] / mean[0] < color[1] / color[0]
        assert 0.6 < mean[1] / color[1] < 1.6


def test_blades_take_the_colour_of_what_is_green() -> None:
    mixed = maps((120, 90, 60))
    pixels = mixed.color_srgb.copy()
    pixels[:8] = (80, 120, 50)
    half_green = PbrMaps("mixed", pixels, mixed.height, pixels, mixed.roughness, 1.0)
    whole, blades = half_green.mean_of_texels(), blade_color(half_green)
    assert whole[1] / whole[0] < blades[1] / blades[0] < (120 / 80) ** 2.4
    np.testing.assert_allclose(blade_color(mixed), mixed.mean_of_texels())
