"""Snow, sastrugi, rippled sand and salt: shapes and colours as wind, sun and salt leave them."""

import numpy as np
import pytest
from numpy.typing import NDArray

from oaisys_core.color import LUMINANCE, linear
from oaisys_core.procedural.textures.recipes import salt, snow, wind_ripples
from oaisys_core.procedural.textures.recipes.finish import TextureMaps

SIZE = 512


def make(recipe: str) -> TextureMaps:
    both = {**snow.RECIPES, **wind_ripples.RECIPES}
    return both[recipe].make(SIZE, np.random.default_rng(2))


@pytest.fixture(scope="module")
def sastrugi() -> TextureMaps:
    return make("sastrugi")


@pytest.fixture(scope="module")
def sand() -> TextureMaps:
    return make("rippled_sand")


def luminance(maps: TextureMaps) -> NDArray[np.float64]:
    return np.asarray(linear(maps.color.astype(float)) @ np.array(LUMINANCE))


def test_sastrugi_are_steep_towards_the_wind(sastrugi: TextureMaps) -> None:
    height_m = sastrugi.height * snow.SASTRUGI_M
    slope = np.diff(height_m, axis=1) * SIZE / snow.SASTRUGI_M
    assert np.quantile(slope, 0.999) > 1.5 * -np.quantile(slope, 0.001)
    assert 0.1 < np.ptp(height_m) < 0.3


def test_hollows_in_snow_are_bluer(sastrugi: TextureMaps) -> None:
    color = linear(sastrugi.color.astype(float))
    dark = luminance(sastrugi) < np.quantile(luminance(sastrugi), 0.02)
    bluer = color[..., 2] / color[..., 0]
    assert 1.01 < bluer[dark].mean() / bluer.mean() < 1.15


def test_sand_ripples_are_as_high_for_their_length_as_measured_ones(sand: TextureMaps) -> None:
    height_m = sand.height * wind_ripples.TILE_M
    spectrum = np.abs(np.fft.rfft(height_m, axis=1)[:, 10:80]).mean(axis=0)
    length_m = wind_ripples.TILE_M / (10 + int(spectrum.argmax()))
    # Of rows of one ripple's length: what is left between trough and crest.
    rows = height_m.reshape(SIZE, -1, SIZE // 32)
    high_m = float(np.median(np.ptp(rows, axis=2)))
    assert length_m == pytest.approx(0.1, abs=0.015)
    assert 10 < length_m / high_m < 20


def test_crests_of_sand_are_brighter(sand: TextureMaps) -> None:
    high, bright = sand.height, luminance(sand)
    crest, trough = high > np.quantile(high, 0.85), high < np.quantile(high, 0.15)
    assert bright.mean() == pytest.approx(0.32, abs=0.005)
    assert 1.05 < bright[crest].mean() / bright[trough].mean() < 1.5


def test_salt_is_pushed_up_where_plates_meet() -> None:
    maps = salt.salt_crust(SIZE, np.random.default_rng(2))
    _, ridge, _ = salt._plates(SIZE // 2, np.random.default_rng(2))
    height_m = maps.height[::2, ::2] * salt.TILE_M
    rise_m = height_m[ridge > 0.8].mean() - height_m[ridge < 0.1].mean()
    assert 0.01 < rise_m < 0.06
    # Ridges around plates of a size have two plates' worth of edge for each.
    assert 0.03 < (ridge > 0.5).mean() < 0.25
    bright = luminance(maps)
    assert bright[::2, ::2][ridge > 0.6].mean() > bright.mean()
