"""Levels of textures: smaller maps that look, on the whole, as what they stand for."""

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.procedural.textures.levels import MIN_PX, level_at, levels_of
from oaisys_core.scene import PbrMaps

SIZE = 64


def maps_of(color: NDArray[np.uint8], normal: NDArray[np.uint8]) -> PbrMaps:
    size = len(color)
    roughness = np.where(np.indices((size, size)).sum(axis=0) % 16 < 8, 30, 240).astype(np.uint8)
    height = np.linspace(0, 1, size * size, dtype=np.float32).reshape(size, size)
    return PbrMaps("made", color, height, normal, roughness, 2.0)


def noisy(size: int = SIZE) -> PbrMaps:
    rng = np.random.default_rng(2)
    color = rng.integers(0, 256, (size, size, 3), dtype=np.uint8)
    return maps_of(color, np.full((size, size, 3), (128, 128, 255), np.uint8))


def luminance(srgb: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Linear light by sRGB's definition."""
    s = srgb / 255.0
    return np.asarray(np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4))


@pytest.mark.parametrize("size", [64, 60, 33])
def test_each_level_has_half_the_size_and_covers_the_same_tile(size: int) -> None:
    levels = levels_of(noisy(size))
    assert [len(level.height) for level in levels] == [size >> k for k in range(len(levels))]
    assert MIN_PX <= len(levels[-1].height) < 2 * MIN_PX
    for level in levels:
        assert {level.color_srgb.shape, level.normal_gl.shape} == {(*level.height.shape, 3)}
        assert level.roughness.shape == level.height.shape
        assert level.tile_m == 2.0


def test_a_texture_too_small_has_no_levels() -> None:
    maps = noisy(MIN_PX)
    assert levels_of(maps) == (maps,)


def test_light_is_kept_not_bytes() -> None:
    maps = noisy()
    for level in levels_of(maps)[1:]:
        mean = luminance(level.color_srgb).mean(axis=(0, 1))
        assert mean == pytest.approx(luminance(maps.color_srgb).mean(axis=(0, 1)), rel=0.02)
        # The mean of bytes is darker by far.
        assert level.color_srgb.mean() > maps.color_srgb.mean() + 15


@pytest.mark.parametrize("sun", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, -0.8, 0.6)])
def test_facets_reflect_as_much_as_they_did_together(sun: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(5)
    # Leaning to all sides by up to 0.4, and all of them by 0.1 to one side.
    lean = rng.uniform(-0.4, 0.4, (SIZE, SIZE, 2)) + np.array((0.1, 0.0))
    normal = np.full((SIZE, SIZE, 3), 255, np.uint8)
    normal[..., :2] = np.rint(lean * 127 + 128)
    maps = maps_of(np.full((SIZE, SIZE, 3), 180, np.uint8), normal)

    def reflected(level: PbrMaps) -> float:
        vector = (level.normal_gl.astype(float) - 128) / 127
        vector[..., 2] = 1
        vector /= np.linalg.norm(vector, axis=-1, keepdims=True)
        return float((luminance(level.color_srgb)[..., 0] * (vector @ np.array(sun))).mean())

    for level in levels_of(maps)[1:]:
        assert reflected(level) == pytest.approx(reflected(maps), rel=0.01)


def test_puddles_stay_puddles() -> None:
    maps = noisy()
    for level in levels_of(maps)[1:]:
        assert set(np.unique(level.roughness)) <= {30, 240}


@pytest.mark.parametrize(
    ("footprint_m", "level"), [(0.001, 0), (2 / 64, 0), (0.05, 0), (4 / 64, 1), (0.2, 2), (99, 3)]
)
def test_texels_are_never_larger_than_a_pixel(footprint_m: float, level: int) -> None:
    maps = noisy()
    found = level_at(maps, len(levels_of(maps)), footprint_m)
    assert found == level
