"""How much of the light is direct: a grey ground and the shadow of a board, as Blender shows them.

Published values: under a clear sky, Bird and Hulstrom (1981), A simplified clear sky model for
direct and diffuse insolation on horizontal surfaces, SERI/TR-642-761; under Mars' dust, Appelbaum
and Flood (1990), Solar radiation on Mars, table III.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, exp, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from synthetic_worlds import SUNNY, camera, flat_world, settings, texture

from oaisys_core.color import LUMINANCE
from oaisys_core.config import load_config
from oaisys_core.config.sections.environment import EnvironmentConfig
from oaisys_core.geometry import pose_looking_at, pose_looking_down, transform
from oaisys_core.procedural.environment.light import (
    level_irradiance_w_m2,
    sky_irradiance_w_m2,
    white_gains,
)
from oaisys_core.scene import Primitive, Scene
from oaisys_core.scene.sky import Sky
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_core.world.module import World
from oaisys_core.world.modules.environment import EnvironmentModule

pytestmark = pytest.mark.blender

MARS = Path(__file__).parents[5] / "config" / "examples" / "environment_mars.yaml"
GROUND_M = 0.25
"""Height of the ground."""
BOARD_M = 13.0
"""Distance of the board from the middle of its shadow; it hides less than 1 % of the sky."""
EARTH_DEG = (15.0, 38.0, 60.0)
MARS_DEG = 9.0
SAMPLES = 64
MIDDLE = PinholeIntrinsics(8, 8, 54.0, 54.0, 3.5, 3.5)
LEVEL_W_M2 = 4.0


def grey_world(sky: Sky) -> Scene:
    """Level grey ground and a board between its middle and the sun."""
    world = flat_world()
    maps = replace(texture("grey", (0, 0, 0), 2.0), color_srgb=np.full((16, 16, 3), 188, np.uint8))
    layers = tuple(replace(layer, maps=maps) for layer in world.material.layers)
    at = np.array((0.0, 0.0, GROUND_M)) + BOARD_M * np.array(sky.to_sun)
    board = Primitive("box", (2.0, 2.0, 0.02), transform(np.eye(3), at), 901, (20,), (0.5,) * 3)
    material = replace(world.material, layers=layers)
    return replace(world, material=material, primitives=(board,), sky=sky)


def brightened(sky: Sky) -> Sky:
    """The same light, as bright as 8-bit images need it."""
    factor = LEVEL_W_M2 / float(level_irradiance_w_m2(sky) @ LUMINANCE)
    return replace(
        sky,
        sun_strength_w_m2=sky.sun_strength_w_m2 * factor,
        sky_strength=sky.sky_strength * factor,
        has_plain=False,
    )


def drawn_sky(**values: Any) -> Sky:
    """The sky that the environment module makes of a configuration."""
    module = EnvironmentModule(EnvironmentConfig(**values))
    world = World()
    module.step_batch(world, {}, np.random.default_rng(1))
    assert world.sky is not None
    return world.sky


@pytest.fixture(scope="module")
def seen() -> dict[str, tuple[FloatArray, FloatArray]]:
    """Mean linear colours of the same ground in light and in the board's shadow, by world."""
    mars = load_config(MARS).environment.model_copy(
        update={"sun_elevation_deg": (MARS_DEG,) * 2, "haze": None}
    )
    skies = {f"earth {deg:g}": drawn_sky(sun_elevation_deg=deg) for deg in EARTH_DEG}
    skies["mars"] = drawn_sky(**mars.model_dump())
    skies["moon"] = drawn_sky(sky={"model": "none"}, sun_elevation_deg=20.0)
    view = camera(pose_looking_down(0.0, 0.0, 6.0), MIDDLE)
    scenes = []
    for sky in skies.values():
        shadowed = grey_world(brightened(sky))
        scenes += [replace(shadowed, primitives=()), shadowed]
    images = in_blender("environment.linear_worlds", scenes, view, SAMPLES)
    colors = [image.mean(axis=(0, 1)) for image in images]
    found = {}
    for index, (name, sky) in enumerate(skies.items()):
        factor = brightened(sky).sky_strength / sky.sky_strength
        found[name] = (colors[2 * index] / factor, colors[2 * index + 1] / factor)
    return found


def direct_share(colors: tuple[FloatArray, FloatArray]) -> float:
    lit, shadow = (float(color @ LUMINANCE) for color in colors)
    return 1 - shadow / lit


def bird(elevation_deg: float) -> float:
    """Direct share on level ground after Bird and Hulstrom, on a clear day at sea level.

    With 0.3 cm of ozone, 1.5 cm of water, an optical depth of aerosols of 0.1 at 500 nm and 0.15 at
    380 nm, and ground with an albedo of 0.2.
    """
    up = sin(radians(elevation_deg))
    m = 1 / (up + 0.15 * (elevation_deg + 3.885) ** -1.253)
    rayleigh = exp(-0.0903 * m**0.84 * (1 + m - m**1.01))
    x = 0.3 * m
    ozone = 1 - 0.1611 * x * (1 + 139.48 * x) ** -0.3035
    ozone += -0.002715 * x / (1 + 0.044 * x + 0.0003 * x * x)
    gases = exp(-0.0127 * m**0.26)
    w = 1.5 * m
    water = 1 - 2.4959 * w / ((1 + 79.034 * w) ** 0.6828 + 6.385 * w)
    depth = 0.2758 * 0.15 + 0.35 * 0.1
    aerosol = exp(-(depth**0.873) * (1 + depth - depth**0.7088) * m**0.9108)
    absorbed = 1 - 0.1 * (1 - m + m**1.06) * (1 - aerosol)
    direct = 0.9662 * rayleigh * ozone * gases * water * aerosol * up
    scattered = up * 0.79 * ozone * water * gases * absorbed
    scattered *= 0.5 * (1 - rayleigh) + 0.84 * (1 - aerosol / absorbed)
    scattered /= 1 - m + m**1.02
    from_above = 0.0685 + 0.16 * (1 - aerosol / absorbed)
    return direct / ((direct + scattered) / (1 - 0.2 * from_above))


@pytest.mark.long
def test_on_earth_four_fifths_to_nine_tenths_are_direct(
    seen: dict[str, tuple[FloatArray, FloatArray]],
) -> None:
    assert 0.80 <= direct_share(seen["earth 38"]) <= 0.90
    for deg in EARTH_DEG:
        assert direct_share(seen[f"earth {deg:g}"]) == pytest.approx(bird(deg), abs=0.04)


def test_on_the_moon_shadows_are_black(seen: dict[str, tuple[FloatArray, FloatArray]]) -> None:
    assert direct_share(seen["moon"]) > 0.99


def test_on_mars_a_low_sun_casts_shadows_through_the_dust(
    seen: dict[str, tuple[FloatArray, FloatArray]],
) -> None:
    """Of the net flux at a zenith angle of 81 degrees, interpolated between 80 and 85."""
    least, most = load_config(MARS).environment.optical_depth or (0, 0)
    assert least == most == 0.3
    on_level = 0.562 + (0.412 - 0.562) / 5
    published = exp(-0.3 / cos(radians(90 - MARS_DEG))) / (on_level / (1 - 0.1))
    assert published > 0.2
    assert direct_share(seen["mars"]) == pytest.approx(published, abs=0.04)


def test_the_sky_gives_as_much_light_as_the_core_takes_it_to(
    seen: dict[str, tuple[FloatArray, FloatArray]],
) -> None:
    """The colour of shadows, which the white balance and distant ground rely on."""
    for deg in EARTH_DEG:
        sky = drawn_sky(sun_elevation_deg=deg)
        shadow = seen[f"earth {deg:g}"][1] * np.pi / 0.5
        expected = sky_irradiance_w_m2(sky)
        assert shadow @ LUMINANCE == pytest.approx(expected @ LUMINANCE, rel=0.15)


def test_a_grey_card_is_grey_under_its_own_illuminant(
    seen: dict[str, tuple[FloatArray, FloatArray]],
) -> None:
    for deg in EARTH_DEG:
        lit, _ = seen[f"earth {deg:g}"]
        balanced = lit * white_gains(drawn_sky(sun_elevation_deg=deg))
        assert np.ptp(balanced) < 0.12 * balanced.mean()


@pytest.mark.long
@pytest.mark.parametrize("denoise", [False, True])
def test_the_meter_sees_the_view_alone(denoise: bool) -> None:
    """A sun and sky of a quarter of the strength need two stops more, in any order of views."""
    bright = replace(SUNNY, sun_elevation_rad=0.8)
    dim = replace(bright, sun_strength_w_m2=1.0, sky_strength=0.25)
    view = camera(pose_looking_at((-12.0, -3.0, 3.0), (0.0, 0.0, 1.0)))
    wanted = replace(settings(2), exposure_ev=None, denoise=denoise)
    skies = [bright, dim, bright]
    first, second, third = in_blender(
        "environment.metered_pictures", flat_world(), view, skies, wanted
    )
    assert second[1] - first[1] == pytest.approx(2.0, abs=2e-3)
    # Cycles' limits and the denoiser know absolute brightness, so single pixels differ.
    assert np.abs(second[0].astype(int) - first[0]).mean() < 1
    assert third[1] == first[1]
    assert (third[0] == first[0]).all()
