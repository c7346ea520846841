"""The ground's albedo without noise is what many samples of Cycles see."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from blender_process import in_blender
from numpy.typing import NDArray
from synthetic_worlds import SUNNY, GivenTone, camera, flat_world

from oaisys_core.geometry import pose_looking_at
from oaisys_core.procedural.terrain.macro_variation import MacroPattern
from oaisys_core.procedural.terrain.surroundings.kinds import EARTH_RADIUS_M
from oaisys_core.procedural.terrain.surroundings.land import land_around
from oaisys_core.procedural.terrain.surroundings.land_masks import PatchyLandMasks
from oaisys_core.scene import HeightField, Lens, PbrMaps, Scene, TerrainLayer, TerrainMaterial
from oaisys_core.scene.sky import Haze
from oaisys_core.scene.terrain_material import Variation
from oaisys_core.scene.tiling import stochastic_tiling, voronoi_tiling
from oaisys_core.types import RGB, PinholeIntrinsics

pytestmark = [pytest.mark.blender, pytest.mark.long]

LENS = PinholeIntrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
SEEN = "Denoising Albedo"
HAZY = Haze((0.02, 0.04, 0.08))


def grainy(seed: int, tile_m: float) -> PbrMaps:
    """A texture of random texels."""
    rng = np.random.default_rng(seed)
    return PbrMaps(
        f"grainy_{seed}",
        rng.integers(30, 220, (256, 256, 3)).astype(np.uint8),
        np.broadcast_to(np.abs(np.linspace(-1, 1, 256, dtype=np.float32)), (256, 256)),
        np.full((256, 256, 3), (128, 128, 255), np.uint8),
        np.full((256, 256), 255, np.uint8),
        tile_m,
    )


def world(*layers: TerrainLayer, slope: float = 0.0, **more: Any) -> Scene:
    """Layers side by side in broad, soft stripes, on ground that rises to the north."""
    axis_m = np.linspace(-20, 20, 41)
    height_m = np.broadcast_to(slope * axis_m[:, None], (41, 41)) + 0.1 * np.sin(axis_m)
    ground = HeightField(height_m.astype(np.float32), (-20.0, -20.0), 1.0)
    phase = np.linspace(0, 20, 64) + 2 * np.arange(len(layers))[:, None]
    share = np.clip(np.sin(phase) + 0.5, 0, 1) + 1e-3
    masks = np.repeat((share / share.sum(axis=0))[:, None], 64, axis=1).astype(np.float32)
    material = TerrainMaterial(layers, masks, ground.extent_m, **more)
    return replace(flat_world(), ground=ground, material=material, primitives=(), sky=SUNNY)


def even(maps: PbrMaps) -> PbrMaps:
    """A texture of one colour, its first texel's, without relief."""
    color = np.broadcast_to(maps.color_srgb[0, 0], maps.color_srgb.shape)
    return replace(maps, color_srgb=color.copy(), height=np.zeros_like(maps.height))


def patchy(scene: Scene) -> Scene:
    """A world whose layers lie in patches that are narrower than a pixel."""
    share = np.random.default_rng(4).uniform(0, 1, (len(scene.material.layers), 512, 512)) ** 3
    masks = (share / share.sum(axis=0)).astype(np.float32)
    return replace(scene, material=replace(scene.material, masks=masks))


def beyond(scene: Scene) -> Scene:
    """A world with land around its stage, where the layers lie in patches of many sizes."""
    material = scene.material
    shares = tuple(material.masks.mean(axis=(1, 2)).tolist())
    land = PatchyLandMasks(material.extent_m, shares, 6.0, 0.1, seed=6)
    return replace(
        scene,
        material=replace(material, land=land),
        far_ground=land_around(scene.ground, 5, EARTH_RADIUS_M),
    )


def cases() -> dict[str, Scene]:
    rng = np.random.default_rng(5)
    layers = tuple(
        TerrainLayer(str(seed), (seed,), grainy(seed, tile_m))
        for seed, tile_m in ((1, 2.0), (2, 3.0), (3, 1.3))
    )
    voronoi = replace(layers[0], tiling=voronoi_tiling(1.5, np.pi, rng))
    shiny = replace(layers[1].maps, roughness=np.full((256, 256), 10, np.uint8))
    colored = Variation(brightness=0.5, tint=0.2)
    stochastic = replace(layers[1], tiling=stochastic_tiling(2.0, rng))
    tone = GivenTone(rng.integers(0, 256, (32, 32, 3), np.uint8))
    return {
        "layers": world(*layers, variation=colored),
        "haze": replace(world(*layers, tone=tone), sky=replace(SUNNY, haze=HAZY)),
        "gentle": world(layers[0], slope=0.3, projects_sides=True),
        "steep": world(layers[0], slope=2.0, projects_sides=True),
        "tiling": world(voronoi, stochastic),
        "patchy": patchy(world(*(replace(each, maps=even(each.maps)) for each in layers))),
        "land": beyond(
            world(
                *layers[:2],
                variation=colored,
                macro=MacroPattern(1.0, 3),
                tone=tone,
            )
        ),
        "lens": world(*layers),
        "wide": world(*layers),
        "shiny": world(layers[0], replace(layers[1], maps=shiny)),
    }


@pytest.fixture(scope="module")
def albedos() -> dict[str, Any]:
    made = cases()
    placed = camera(pose_looking_at((1, -9, 2.0), (0, 0, 0)), LENS, (RGB,))
    steep = camera(pose_looking_at((1, -9, -10), (0, 0, 0)), LENS, (RGB,))
    outward = camera(pose_looking_at((2, 17, 3.0), (0, 27, 0)), LENS, (RGB,))
    special = {
        "steep": steep,
        "land": outward,
        "lens": replace(placed, lens=Lens(focus_distance_m=4.0, f_number=0.4, ratio=0.5)),
        "wide": replace(placed, lens=Lens(focus_distance_m=4.0, f_number=0.03)),
    }
    views = [(scene, special.get(name, placed)) for name, scene in made.items()]
    return dict(zip(made, in_blender("materials.albedos", views, 2, 64), strict=True))


def rms(difference: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(difference))))


@pytest.mark.parametrize(
    ("name", "noise"),
    [
        ("layers", 0.6),
        ("haze", 0.6),
        ("gentle", 0.6),
        ("tiling", 0.6),
        ("patchy", 0.6),
        ("land", 0.85),
        ("lens", 0.6),
        ("wide", 0.53),
    ],
)
def test_the_mean_of_many_samples_is_known_with_less_noise(
    albedos: dict[str, Any], name: str, noise: float
) -> None:
    found = albedos[name]
    known = found["known"]
    assert known.mean() > (0.1 if name == "wide" else 0.5)
    few, many, clean = (found[key][known] for key in ("few", "many", "clean"))
    np.testing.assert_allclose(clean.mean(axis=0), many.mean(axis=0), rtol=0.01)
    assert rms(clean - many) < noise * rms(few - many)


def test_only_what_is_almost_in_focus_is_known(albedos: dict[str, Any]) -> None:
    without, blurred = (albedos[name]["known"] for name in ("layers", "wide"))
    in_focus = blurred.all(axis=1)
    # Nearer and farther ground, at the image's lower and upper end, is blurred.
    assert in_focus.any()
    assert without[-1].all()
    assert not blurred[-1].any()
    assert not blurred[np.argmax(without.all(axis=1))].any()


def test_nothing_is_known_where_one_of_the_layers_is_glossy(albedos: dict[str, Any]) -> None:
    found = albedos["shiny"]
    known = found["known"]
    assert 0.05 < known.mean() < 0.8
    assert rms((found["clean"] - found["many"])[known]) < 0.6 * rms(
        (found["few"] - found["many"])[known]
    )


def test_steep_slopes_are_unknown(albedos: dict[str, Any]) -> None:
    assert not albedos["steep"]["known"].any()
