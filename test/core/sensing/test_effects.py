"""Effects on colour against their closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic_worlds import CENTRED, SKEWED, camera, flat_world, settings

from oaisys_core.color import linear
from oaisys_core.geometry import pose_looking_down
from oaisys_core.render.analytic import AnalyticBackend
from oaisys_core.sensing.effects import NO_EFFECTS, Bloom, Effects, SensorNoise, with_effects
from oaisys_core.types import DEPTH, RGB

GREY = 150


def grey(level: int = GREY) -> NDArray[np.uint8]:
    return np.full((SKEWED.height_px, SKEWED.width_px, 3), level, np.uint8)


def generator() -> np.random.Generator:
    return np.random.default_rng(1)


def test_without_effects_the_picture_is_the_same_object() -> None:
    image = grey()
    assert with_effects(image, NO_EFFECTS, SKEWED, generator()) is image


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_vignetting_follows_the_fourth_power_of_the_cosine(share: float) -> None:
    seen = linear(with_effects(grey(), Effects(vignetting=share), SKEWED, generator()) / 255)
    v, u = np.mgrid[: SKEWED.height_px, : SKEWED.width_px]
    x, y = (u - SKEWED.cx_px) / SKEWED.fx_px, (v - SKEWED.cy_px) / SKEWED.fy_px
    cos = np.cos(np.arctan(np.hypot(x, y)))
    expected = linear(GREY / 255) * (1 - share + share * cos**4)
    np.testing.assert_allclose(seen[..., 0], expected, atol=0.004)


def test_noise_has_the_variance_of_counted_electrons() -> None:
    noise = SensorNoise(full_well_e=2000.0, read_noise_e=20.0)
    seen = linear(with_effects(grey(), Effects(noise=noise), SKEWED, generator()) / 255)
    signal = float(linear(GREY / 255))
    expected = np.sqrt(signal * 2000.0 + 20.0**2) / 2000.0
    assert seen.mean() == pytest.approx(signal, abs=4 * expected / np.sqrt(seen.size))
    assert seen.std() == pytest.approx(expected, rel=0.05)
    channels = seen.reshape(-1, 3) - signal
    assert np.abs(np.corrcoef(channels.T) - np.eye(3)).max() < 0.1


def test_bloom_spills_light_around_what_is_bright() -> None:
    image = np.zeros((61, 61, 3), np.uint8)
    image[30, 30] = 255
    intrinsics = replace(SKEWED, width_px=61, height_px=61)
    bloom = Bloom(threshold=0.5, radius_px=3.0, strength=1.0)
    seen = linear(with_effects(image, Effects(bloom=bloom), intrinsics, generator()) / 255)
    v, u = np.mgrid[-30:31, -30:31]
    expected = 0.5 * np.exp(-(u**2 + v**2) / (2 * 3.0**2)) / (2 * np.pi * 3.0**2)
    expected[30, 30] += 1.0
    np.testing.assert_allclose(seen[..., 1], np.minimum(expected, 1.0), atol=5e-4)
    dim = Effects(bloom=replace(bloom, threshold=1.0))
    assert (with_effects(image, dim, intrinsics, generator()) == image).all()


def test_chromatic_aberration_magnifies_red_and_shrinks_blue() -> None:
    ramp = np.tile(np.arange(0, 180, 2, dtype=np.uint8)[None, :, None], (50, 1, 3))
    effects = Effects(chromatic_aberration=0.05)
    seen = linear(with_effects(ramp, effects, SKEWED, generator()) / 255)
    before = linear(ramp / 255)[25]
    u = np.arange(90.0)
    for channel, factor in ((0, 1 / 1.05), (1, 1.0), (2, 1.05)):
        source = SKEWED.cx_px + (u - SKEWED.cx_px) * factor
        inside = (source > 0) & (source < 89)
        expected = np.interp(source, u, before[:, channel])
        np.testing.assert_allclose(seen[25, inside, channel], expected[inside], atol=0.004)


def test_effects_touch_colour_only_and_repeat_with_their_seed() -> None:
    backend = AnalyticBackend()
    backend.build(flat_world(), lambda _: None)
    view = camera(pose_looking_down(0, 0, 9), CENTRED, (RGB, DEPTH))
    noise = Effects(noise=SensorNoise(500.0, 5.0))

    def rendered(noise_seed: int, effects: Effects) -> list[bytes]:
        wanted = replace(settings(), effects=effects, noise_seed=noise_seed)
        return [f.data.tobytes() for f in backend.render_all([view], wanted, lambda _: None)]

    plain, first, again, other = (
        rendered(3, NO_EFFECTS),
        rendered(3, noise),
        rendered(3, noise),
        rendered(4, noise),
    )
    assert first == again
    assert first[0] not in (plain[0], other[0])
    assert plain[1] == first[1] == other[1]
