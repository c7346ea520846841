"""Grass and moss: as many blades as were sown, as wide as such plants, as green and as bright."""

import numpy as np
import pytest

from oaisys_core import randomness
from oaisys_core.procedural.textures.recipes import grass, moss, swards
from oaisys_core.procedural.textures.recipes.finish import TextureMaps
from oaisys_core.procedural.textures.recipes.swards import Blade, Plot, grow, grow_clover

SIZE = 256
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
GREEN = ((0.1, 0.2, 0.05),)


def linear(color: np.ndarray) -> np.ndarray:
    """Linear values by the definition of sRGB, not by our code."""
    return np.asarray(np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4))


@pytest.fixture(scope="module")
def made() -> dict[str, TextureMaps]:
    makers = {"grass": grass.grass, "moss": moss.moss}
    return {name: make(SIZE, randomness.stream(1, name)) for name, make in makers.items()}


@pytest.mark.parametrize(("name", "albedo"), [("grass", swards.ALBEDO), ("moss", moss.ALBEDO)])
def test_it_is_green_and_as_bright_as_published(
    made: dict[str, TextureMaps], name: str, albedo: float
) -> None:
    color = linear(made[name].color.astype(np.float64))
    assert np.isclose((color @ LUMINANCE).mean(), albedo, rtol=0.02)
    red, green, blue = color.mean(axis=(0, 1))
    assert green > red > 1.2 * blue
    is_green = color[..., 1] > color[..., 0]
    assert 0.4 < is_green.mean() < 0.97


def plain_plot(tile_m: float = 1.0, share: float = 1.0) -> Plot:
    flat = np.zeros((1024, 1024), np.float32)
    return Plot(tile_m, flat, flat[:8, :8], np.full((32, 32), share, np.float32), flat[:8, :8])


@pytest.mark.parametrize("tile_m", [1.0, 2.0])
def test_a_kind_is_sown_as_densely_and_as_large_as_it_says(tile_m: float) -> None:
    kind = Blade(3000, (0.04, 0.1), (0.002, 0.004), (0.2, 0.8), (0.3, 1.0), GREEN, 0.02, 10)
    crop = grow(kind, plain_plot(tile_m, 0.5), np.random.default_rng(0))
    blades = crop.blades
    assert np.isclose(len(blades.length), 0.5 * 3000 * tile_m**2, rtol=0.15)
    width_m, length_m = blades.width * tile_m, blades.length * tile_m
    assert 0.002 <= width_m.min() < width_m.max() <= 0.004
    assert np.isclose(width_m.mean(), 0.003, rtol=0.02)
    # Poor tufts have blades of 0.6 times the length.
    assert 0.6 * 0.04 <= length_m.min() < length_m.max() <= 0.1
    assert crop.colors.shape == (len(blades.length), 3)


def test_a_tuft_leans_outwards() -> None:
    kind = Blade(900, (0.05, 0.05), (0.002, 0.002), (0.5, 0.5), (0, 0), GREEN, 0.02, 900)
    blades = grow(kind, plain_plot(), np.random.default_rng(0)).blades
    away = blades.foot[:, :2] - blades.foot[:, :2].mean(axis=0)
    way = np.column_stack((np.sin(blades.heading), np.cos(blades.heading)))
    outward = (away * way).sum(axis=1) / np.linalg.norm(away, axis=1)
    assert outward.mean() > 0.4


def test_dry_blades_are_of_straw() -> None:
    kind = Blade(5000, (0.05, 0.05), (0.002, 0.002), (0.5, 0.5), (0, 0), GREEN, dry=0.3)
    colors = grow(kind, plain_plot(), np.random.default_rng(0)).colors
    is_straw = colors[:, 0] > colors[:, 1]
    assert np.isclose(is_straw.mean(), 0.3, atol=0.03)


def test_clover_has_three_leaflets_from_one_point() -> None:
    crop = grow_clover(400, (0.02, 0.05), GREEN, plain_plot(), np.random.default_rng(0))
    foot = crop.blades.foot.reshape(-1, 3, 3)
    assert len(foot) == 400
    assert np.ptp(foot, axis=1).max() == 0
    assert (foot[..., 2] >= 0.02).all()
    turn = np.diff(crop.blades.heading.reshape(-1, 3), axis=1)
    assert np.allclose(turn, 2 * np.pi / 3)


def test_it_grows_where_its_density_is() -> None:
    density = np.zeros((32, 32), np.float32)
    density[:, :16] = 1
    kind = Blade(2000, (0.05, 0.05), (0.002, 0.002), (0.5, 0.5), (0, 0), GREEN)
    plot = plain_plot()._replace(density=density)
    blades = grow(kind, plot, np.random.default_rng(0)).blades
    assert (blades.foot[:, 1] < 0.5).all()
    assert len(blades.length) > 800


def test_coarse_texels_show_fewer_and_wider_blades() -> None:
    """The area of all of them remains."""
    kind = Blade(3000, (0.05, 0.05), (0.002, 0.002), (0.5, 0.5), (0, 0), GREEN)
    fine = plain_plot()
    coarse = fine._replace(ground=fine.ground[:64, :64])
    many, few = (grow(kind, plot, np.random.default_rng(0)).blades for plot in (fine, coarse))
    assert len(few.length) < 0.3 * len(many.length)
    assert np.isclose(few.width.sum(), many.width.sum(), rtol=0.05)
