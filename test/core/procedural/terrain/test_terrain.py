"""Grounds and masks drawn from a seed; those made by processes are in `test_presets`."""

from functools import cache

import numpy as np
import pytest

from oaisys_core.errors import InvalidInputError
from oaisys_core.procedural.terrain.masks.patches import blend_masks
from oaisys_core.procedural.terrain.noise import fractal, gradient_noise, grid
from oaisys_core.procedural.terrain.presets import PRESETS, SHAPED, make_ground
from oaisys_core.scene import HeightField


@cache
def ground(preset: str, seed: int = 0, **more: float) -> HeightField:
    return make_ground(preset, 40.0, 257, np.random.default_rng(seed), **more)


@pytest.mark.parametrize("preset", sorted(PRESETS.keys() - SHAPED))
def test_a_preset_has_the_size_asked_for(preset: str) -> None:
    field = ground(preset)
    assert field.elevation_m.shape == (257, 257)
    assert field.elevation_m.dtype == np.float32
    assert field.extent_m == pytest.approx((-20, -20, 20, 20))
    assert np.isfinite(field.elevation_m).all()


@pytest.mark.parametrize("preset", sorted(PRESETS.keys() - SHAPED))
def test_equal_seeds_give_equal_bytes(preset: str) -> None:
    again = ground.__wrapped__(preset)
    assert ground(preset).elevation_m.tobytes() == again.elevation_m.tobytes()


@pytest.mark.parametrize("preset", ["mounds", "mountain_1"])
def test_other_seeds_give_other_grounds(preset: str) -> None:
    assert ground(preset, 0).elevation_m.tobytes() != ground(preset, 1).elevation_m.tobytes()


def test_a_plane_is_exactly_flat() -> None:
    assert (ground("plane").elevation_m == 0).all()


@pytest.mark.parametrize("preset", ["mounds", "mountain_1"])
def test_the_relief_is_what_was_asked_for(preset: str) -> None:
    smooth = ground(preset, relief_m=7.0, roughness=0.0).elevation_m
    assert np.ptp(smooth) == pytest.approx(7.0, rel=1e-5)


def test_the_default_ground_is_uneven_at_every_scale() -> None:
    elevation_m = ground("mounds").elevation_m.astype(float)
    assert np.ptp(elevation_m) > 3.0
    curvature_m = np.abs(np.diff(elevation_m, 2, axis=1))
    assert curvature_m.mean() > 5e-3, "rough underfoot: millimetres from one grid point to the next"


def test_the_mountain_stands_in_the_middle_and_is_steep() -> None:
    field = ground("mountain_1")
    rim = np.concatenate((field.elevation_m[0], field.elevation_m[-1], field.elevation_m[:, 0]))
    assert field.elevation_m[96:161, 96:161].max() - rim.max() > 5.0
    slope = np.hypot(*np.gradient(field.elevation_m.astype(float), field.spacing_m))
    assert np.degrees(np.arctan(np.percentile(slope, 95))) > 30


def test_unknown_presets_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="mounds"):
        ground("ocean")


def test_noise_repeats_after_its_period_and_is_smooth() -> None:
    x, y = grid(8.0, 161, 1.0)
    noise = fractal(x, y, np.random.default_rng(1), octaves=3, period=8)
    assert np.allclose(noise[0], noise[-1], atol=1e-5)
    assert np.allclose(noise[:, 0], noise[:, -1], atol=1e-5)
    single = gradient_noise(x, y, np.random.default_rng(1), 8)
    assert np.abs(np.diff(single, axis=0)).max() < 0.25
    assert np.allclose(single[::20, ::20], 0, atol=1e-6), "gradient noise is 0 on its lattice"


@pytest.mark.parametrize("layers", [1, 2, 4])
@pytest.mark.parametrize("sharpness", [0.0, 0.75, 1.0])
def test_masks_share_the_ground(layers: int, sharpness: float) -> None:
    masks = blend_masks(layers, 60.0, 128, np.random.default_rng(3), 9.0, sharpness)
    assert masks.shape == (layers, 128, 128)
    assert masks.dtype == np.float32
    assert np.allclose(masks.sum(axis=0), 1, atol=1e-5)
    share = np.bincount(masks.argmax(axis=0).ravel(), minlength=layers) / 128**2
    assert (share > 0.3 / layers).all()


def test_sharper_masks_mix_less() -> None:
    def mixed(sharpness: float) -> float:
        masks = blend_masks(2, 60.0, 128, np.random.default_rng(3), 9.0, sharpness)
        return float((masks.max(axis=0) < 0.95).mean())

    assert mixed(0.0) > mixed(0.75) > mixed(1.0)
