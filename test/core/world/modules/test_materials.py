"""The materials module: pools, metadata, changed textures, label images, displacement."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy
from PIL import Image

from oaisys_core import randomness
from oaisys_core.config.sections.materials import MaterialsConfig
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.procedural.terrain.displacement import LayerRelief, displace, relief_of_maps
from oaisys_core.procedural.terrain.mesh_ground import MeshGround
from oaisys_core.procedural.terrain.water.ponds import NO_WATER, Water, WaterLook
from oaisys_core.procedural.textures.adjusting import ColorChange, recolor, with_relief
from oaisys_core.procedural.textures.label_image import load_label_image
from oaisys_core.scene import HeightField, PbrMaps, TerrainLayer, TerrainMaterial
from oaisys_core.scene.tiling import PlainTiling, StochasticTiling, VoronoiTiling
from oaisys_core.types import FloatArray
from oaisys_core.world.module import World
from oaisys_core.world.modules import MaterialsModule
from oaisys_core.world.modules.layers import choose_layers

POOL = [
    {"texture": name, "label": name, "semantic_id": index + 1}
    for index, name in enumerate(("gravel", "sand", "regolith", "rock"))
]


def config(**keys: Any) -> MaterialsConfig:
    small = {"texture_size_px": 16, "mask": {"size_px": 64}}
    return MaterialsConfig.model_validate(small | keys)


def world_of(
    materials: MaterialsConfig, metadata: dict[str, Any] | None = None, seed: int = 1
) -> World:
    axis = np.linspace(0, 6, 65)
    return world_on(np.add.outer(axis, np.sin(axis)), materials, metadata, seed)


def world_on(
    height_m: FloatArray,
    materials: MaterialsConfig,
    metadata: dict[str, Any] | None = None,
    seed: int = 1,
    **of_world: Any,
) -> World:
    ground = HeightField(height_m.astype(np.float32), (-4, -4), 0.125)
    world = World(ground=ground, stage_hash="stage", **of_world)
    module = MaterialsModule(materials)
    module.setup()
    module.check(metadata)
    module.step_batch(world, metadata, randomness.stream(seed, "materials"))
    return world


def names(materials: MaterialsConfig, seed: int) -> list[str]:
    return [layer.label for layer in choose_layers(materials, randomness.stream(seed, "materials"))]


def test_pools_draw_as_many_layers_as_told() -> None:
    materials = config(pools=[{"layers": POOL, "count": [1, 3]}])
    drawn = [names(materials, seed) for seed in range(200)]
    assert {len(each) for each in drawn} == {1, 2, 3}
    assert all(len(set(each)) == len(each) for each in drawn)
    assert {name for each in drawn for name in each} == {each["label"] for each in POOL}
    assert drawn[7] == names(materials, 7)


def test_with_replacement_a_layer_may_come_twice() -> None:
    materials = config(pools=[{"layers": POOL[:2], "count": [5, 5], "replacement": True}])
    assert len(names(materials, 0)) == 5
    without = config(pools=[{"layers": POOL[:2], "count": [5, 5]}])
    assert sorted(names(without, 0)) == ["gravel", "sand"]


def test_another_pool_does_not_reshuffle_the_first() -> None:
    first = {"layers": POOL, "count": [1, 3]}
    more = {"layers": [{"texture": "rock", "label": "more", "semantic_id": 9}]}
    for seed in range(20):
        both = names(config(pools=[first, more]), seed)
        assert both[:-1] == names(config(pools=[first]), seed)


def test_textures_whose_repetition_would_be_seen_are_turned_and_shifted(tmp_path: Path) -> None:
    assert cv2.imwrite(str(tmp_path / "ground_col.png"), np.full((8, 8, 3), 90, np.uint8))
    looks: list[dict[str, Any]] = [
        {"texture": "bedrock"},
        {"texture": "bedrock", "anti_tiling": "none"},
        {"texture": "sand"},
        {"texture": "sand", "anti_tiling": "stochastic"},
        {"texture": "bedrock", "folder": str(tmp_path)},
    ]
    layers = [
        {"label": f"layer_{index}", "semantic_id": index + 1} | look
        for index, look in enumerate(looks)
    ]
    material = world_of(config(layers=layers)).material
    assert material is not None
    kinds = [type(layer.tiling) for layer in material.layers]
    assert kinds == [VoronoiTiling, PlainTiling, PlainTiling, StochasticTiling, PlainTiling]


def test_folders_of_a_pool_are_labelled_by_name_or_table(tmp_path: Path) -> None:
    for name in ("beach", "desert"):
        (tmp_path / name).mkdir()
        colour = np.full((8, 8, 3), 90, np.uint8)
        assert cv2.imwrite(str(tmp_path / name / f"{name}_col.png"), colour)
    pool = {
        "folder": str(tmp_path),
        "count": [2, 2],
        "first_semantic_id": 70,
        "labels": {"desert": {"label": "dry", "semantic_id": 5}},
        "look": {"tile_m": 3},
    }
    world = world_of(config(pools=[pool]))
    assert world.semantic_labels == {70: "beach", 5: "dry"}
    assert world.material is not None
    assert {layer.maps.tile_m for layer in world.material.layers} == {3.0}


def test_labels_of_a_pool_name_its_folders(tmp_path: Path) -> None:
    (tmp_path / "beach").mkdir()
    assert cv2.imwrite(str(tmp_path / "beach" / "a_col.png"), np.zeros((4, 4, 3), np.uint8))
    labels = {"beech": {"label": "sand", "semantic_id": 5}}
    with pytest.raises(ConfigError, match=r"beech.*beach"):
        MaterialsModule(config(pools=[{"folder": str(tmp_path), "labels": labels}]))


def test_the_default_material_needs_no_draw_but_its_masks() -> None:
    first, again = world_of(config()).material, world_of(config()).material
    assert first is not None
    assert again is not None
    assert first.masks.tobytes() == again.masks.tobytes()
    assert [layer.label for layer in first.layers] == ["gravel", "sand"]
    varied = [{**layer, "tile_m": [1, 3], "color": {"hue_deg": [-20, 20]}} for layer in POOL[:2]]
    other = world_of(config(layers=varied)).material
    assert other is not None
    assert other.masks.tobytes() == first.masks.tobytes(), "how layers look moves no mask"


def test_metadata_changes_one_batch() -> None:
    layers = [{"texture": "rock", "label": "rocky", "semantic_id": 33, "levels": []}]
    world = world_of(config(), {"layers": layers, "label_borders": "soft", "label_cell_m": 0.1})
    assert world.material is not None
    assert world.material.label_cell_m == 0.1
    assert world.semantic_labels == {33: "rocky"}
    seeded = [world_of(config(), {"seed": 5}, seed).material for seed in (1, 2)]
    assert seeded[0] is not None
    assert seeded[1] is not None
    assert seeded[0].masks.tobytes() == seeded[1].masks.tobytes()


@pytest.mark.parametrize(
    ("metadata", "field"),
    [
        ({"layer": []}, "metadata.materials.layer"),
        ({"layers": []}, "metadata.materials"),
        ({"mask": {"sharpness": 2}}, "metadata.materials.mask.sharpness"),
        (
            {"layers": [{"texture": "velvet", "label": "a", "semantic_id": 1}]},
            "metadata.materials.layers.0.texture",
        ),
        ({"seed": -1}, "metadata.materials.seed"),
    ],
)
def test_metadata_is_refused_by_its_path(metadata: dict[str, Any], field: str) -> None:
    module = MaterialsModule(config())
    with pytest.raises(InvalidInputError) as caught:
        module.check(metadata)
    assert caught.value.field.startswith(field)
    with pytest.raises(InvalidInputError, match="sample"):
        module.check_sample({"seed": 1})


def test_an_id_has_one_name() -> None:
    twice = [{"label": "a", "semantic_id": 1}, {"label": "b", "semantic_id": 1}]
    with pytest.raises(ConfigError, match="name 'a'"):
        MaterialsModule(config(layers=twice))


def test_a_label_image_is_mapped_by_its_pixels(tmp_path: Path) -> None:
    grey = np.random.default_rng(0).choice([0, 7, 255], (12, 9)).astype(np.uint8)
    path = tmp_path / "labels.png"
    assert cv2.imwrite(str(path), grey)
    found = load_label_image(path, {"0": (4, 40), "255": (5,)}, (1, 10)).semantic_ids
    assert (found[0] == np.select([grey == 0, grey == 255], [4, 5], 1)).all()
    assert (found[1] == np.where(grey == 0, 40, 10)).all()
    colour = np.stack((grey, 255 - grey, 0 * grey), axis=-1)
    assert cv2.imwrite(str(path), colour)
    by_colour = load_label_image(path, {"#00f807": (6,)}, (1,)).semantic_ids
    assert (by_colour[0] == np.where(grey == 7, 6, 1)).all()
    with pytest.raises(InvalidInputError, match="#00ff00"):
        load_label_image(path, {"#ffffff": (6,)}, (1,))
    with pytest.raises(InvalidInputError, match="that can be read"):
        load_label_image(tmp_path / "none.png", {"0": (6,)}, (1,))


def test_numbers_of_a_palette_are_no_grey_values(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Sets of segmentation have palettes, whose colours count; a mapping by number is warned of."""
    image = Image.fromarray(np.arange(3, dtype=np.uint8).repeat(12).reshape(6, 6), "P")
    image.putpalette([0, 0, 0, 128, 0, 0, 0, 128, 0])
    path = tmp_path / "palette.png"
    image.save(path)
    with caplog.at_level(logging.WARNING):
        load_label_image(path, {"0": (7,), "1": (8,), "2": (9,)}, (1,))
    (record,) = caplog.records
    assert "palette.png: no pixel has the grey value 1, 2 of labels_from" in record.message
    assert "#000000, #008000, #800000" in record.message
    caplog.clear()
    found = load_label_image(path, {"0": (7,), "#800000": (8,), "#008000": (9,)}, (1,))
    assert not caplog.records
    assert sorted(np.unique(found.semantic_ids)) == [7, 8, 9]


def maps(color: tuple[int, int, int], height: np.ndarray, tile_m: float = 2.0) -> PbrMaps:
    size = len(height)
    image = np.empty((size, size, 3), np.uint8)
    image[:] = color
    normal = np.full((size, size, 3), (128, 128, 255), np.uint8)
    rough = np.full((size, size), 200, np.uint8)
    return PbrMaps("a", image, height.astype(np.float32), normal, rough, tile_m)


def test_colours_turn_and_scale_in_linear_light() -> None:
    plain = maps((188, 92, 92), np.zeros((4, 4)))
    assert recolor(plain, ColorChange()) is plain
    turned = recolor(plain, ColorChange(hue_deg=120)).color_srgb[0, 0]
    assert np.allclose(turned, (92, 188, 92), atol=1)
    # sRGB 188 is a linear 0.503, and half of that is 137; 92 is 0.107, and half of it 66.
    halved = recolor(plain, ColorChange(value=0.5)).color_srgb[0, 0]
    assert np.allclose(halved, (137, 66, 66), atol=1)
    grey = recolor(plain, ColorChange(saturation=1e-9)).color_srgb[0, 0]
    assert np.ptp(grey.astype(int)) <= 1
    # A curve through (0.503, 0.107) sends this red to the others' value.
    curved = recolor(plain, ColorChange(curves={"red": [(0.503, 0.107)]})).color_srgb[0, 0]
    assert np.allclose(curved, (92, 92, 92), atol=1)


def test_relief_gives_the_slopes_of_its_height_map() -> None:
    x = (np.arange(64) + 0.5) / 64
    wave = np.broadcast_to(0.5 + 0.5 * np.sin(2 * np.pi * x), (64, 64))
    lit = (with_relief(maps((90, 90, 90), wave), 0.1, 1.0).normal_gl.astype(float) - 128) / 127
    slope = -lit[..., 0] / lit[..., 2]
    expected = 0.05 * 2 * np.pi / 2.0 * np.cos(2 * np.pi * x)
    assert np.allclose(slope, expected, atol=0.012)


@pytest.mark.parametrize("strength", [0.5, 1.0, 2.0])
def test_relief_is_found_again_in_the_normals(strength: float) -> None:
    x = 2 * np.pi * (np.arange(256) + 0.5) / 256
    rough = 0.5 + 0.3 * np.sin(3 * x) * np.cos(2 * x[:, None]) + 0.1 * np.sin(7 * x[:, None])
    shaded = with_relief(maps((90, 90, 90), rough), 0.07, strength)
    assert relief_of_maps(shaded) == pytest.approx(0.07 * strength, rel=0.02)


def test_flat_maps_have_no_relief() -> None:
    flat = maps((90, 90, 90), np.full((64, 64), 0.5))
    assert relief_of_maps(flat) == 0
    rough = np.random.default_rng(1).random((64, 64), np.float32)
    assert relief_of_maps(replace(flat, height=rough)) == 0


def test_displaced_ground_is_the_height_map_in_metres() -> None:
    spacing_m, tile_m, relief_m = 0.05, 2.0, 0.3
    x = (np.arange(256) + 0.5) / 256
    row_up = 1 - x[:, None]
    wave = 0.5 + 0.25 * np.sin(2 * np.pi * x) + 0.25 * np.cos(2 * np.pi * row_up)
    layer = TerrainLayer("a", (1,), maps((90, 90, 90), wave, tile_m))
    ground = HeightField(np.full((81, 101), 5.0, np.float32), (-2.5, -2.0), spacing_m)
    material = TerrainMaterial((layer,), np.ones((1, 4, 4), np.float32), ground.extent_m)
    moved = displace(ground, LayerRelief(material, (relief_m,)))
    at = moved.vertices_m()
    u, v = at[:, 0] / tile_m, at[:, 1] / tile_m
    expected = 5 + relief_m * 0.25 * (np.sin(2 * np.pi * u) + np.cos(2 * np.pi * v))
    assert np.allclose(at[:, 2], expected, atol=0.002)


def test_displacement_moves_the_stage_and_its_hash() -> None:
    raised = [{**POOL[0], "displacement_m": 0.2}]
    bump = world_of(config(layers=raised))
    geometry = world_of(config(layers=raised, displacement="geometry"))
    assert bump.stage_hash == "stage"
    assert geometry.stage_hash != "stage"
    assert bump.ground is not None
    assert geometry.ground is not None
    change_m = geometry.ground.vertices_m()[:, 2] - bump.ground.vertices_m()[:, 2]
    assert 0.01 < np.ptp(change_m) < 0.2
    again = world_of(config(layers=raised, displacement="geometry"))
    assert again.stage_hash == geometry.stage_hash


def test_the_ground_s_tone_is_made_where_colour_is_asked_for_and_always_the_same() -> None:
    first, second = (world_of(config()).material for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.tone is not None
    assert second.tone is not None
    assert "pixels" not in vars(first.tone)
    assert first.tone.pixels.shape == (64, 64, 3)
    assert first.tone.pixels is first.tone.pixels
    np.testing.assert_array_equal(first.tone.pixels, second.tone.pixels)


@pytest.mark.parametrize("loose", ["gravel", "sand", "turf"])
def test_nothing_loose_lies_on_a_wall_of_bare_rock(loose: str) -> None:
    across = np.arange(65)
    # Two levels, and 55 to 60 degrees between them from the 24th to the 40th column.
    height_m = np.tile(0.2 * np.clip(across - 24, 0, 16), (65, 1))
    layers = [
        {"texture": name, "label": name, "semantic_id": number}
        for number, name in enumerate((loose, "bedrock"), 1)
    ]
    for seed in range(3):
        material = world_on(height_m, config(layers=layers), seed=seed).material
        assert material is not None
        share = material.masks[0]
        assert share[:, 28:36].max() < 0.1, "on the wall"
        assert share[:, :20].mean() > 0.4, "below it"


def test_gravel_lies_on_a_wall_where_there_is_nothing_else() -> None:
    height_m = np.tile(0.2 * np.arange(65), (65, 1))
    layers = [
        {"texture": name, "label": name, "semantic_id": number}
        for number, name in enumerate(("gravel", "sand"), 1)
    ]
    material = world_on(height_m, config(layers=layers)).material
    assert material is not None
    assert material.masks.mean(axis=(1, 2)).min() > 0.2


LEVELS_M = np.tile(np.where(np.arange(65) < 32, 0.0, 2.0), (65, 1))
"""Two levels, with their border between -0.125 m and 0 m."""

SNOW_ABOVE = [
    {"texture": "bedrock", "label": "rock", "semantic_id": 1, "when": {"height_m": [-1, 1]}},
    {"texture": "snow", "label": "snow", "semantic_id": 2, "when": {"height_m": [1, 9]}},
]


@pytest.mark.parametrize(("given_m", "depth_m"), [(None, 0.5), (0.2, 0.2)])
def test_snow_raises_the_ground_less_towards_its_border(
    given_m: float | None, depth_m: float
) -> None:
    materials = config(layers=SNOW_ABOVE, snow_depth_m=given_m)
    world = world_on(LEVELS_M, materials, has_rock_walls=given_m is None)
    assert isinstance(world.ground, HeightField)
    raised_m = world.ground.elevation_m - LEVELS_M
    assert np.abs(raised_m[:, :31]).max() < 1e-6, "rock"
    inside_m = (np.arange(34, 65) - 32) * 0.125
    spread = 1.8 * depth_m
    expected_m = depth_m * (0.4 + 0.6 * scipy.stats.norm.cdf(inside_m / spread))
    np.testing.assert_allclose(raised_m[32, 34:], expected_m, atol=0.05 * depth_m)
    assert world.stage_hash != "stage"


@pytest.mark.parametrize("layers", [SNOW_ABOVE, SNOW_ABOVE[1:]], ids=["no_walls", "snow_alone"])
def test_snow_leaves_other_ground_where_it_is(layers: list[dict[str, Any]]) -> None:
    world = world_on(LEVELS_M, config(layers=layers), has_rock_walls=len(layers) == 1)
    assert isinstance(world.ground, HeightField)
    np.testing.assert_array_equal(world.ground.elevation_m, LEVELS_M)
    assert world.stage_hash == "stage"


@pytest.mark.parametrize("other", [{}, {"when": {"slope_deg": [60, 90]}}], ids=["any", "steep"])
@pytest.mark.parametrize("method", ["patches", "noise"])
def test_plants_end_where_water_is_deep(other: dict[str, Any], method: str) -> None:
    height_m = np.tile(np.linspace(0, 2, 65), (65, 1))
    layers = [
        {"texture": "moss", "label": "moss", "semantic_id": 1},
        {"texture": "mud", "label": "mud", "semantic_id": 2} | other,
    ]
    look = WaterLook(1.0, (0.1, 0.1, 0.1), 0.0)
    water = Water(1.0, (40,), look, NO_WATER, 0.1)
    materials = config(layers=layers, mask={"size_px": 64, "method": method})
    material = world_on(height_m, materials, water=water).material
    assert material is not None
    moss = material.masks[0]
    at_m = (np.arange(64) + 0.5) / 32
    assert moss[:, at_m < 0.6].max() == 0.0, "deep"
    assert moss[:, at_m > 1.0].mean() > 0.3, "dry"


def test_snow_on_a_mesh_is_refused_where_it_is_asked_for() -> None:
    grid = HeightField(LEVELS_M.astype(np.float32), (-4, -4), 0.125)
    ground = MeshGround(grid.vertices_m(), grid.triangles())
    module = MaterialsModule(config(layers=SNOW_ABOVE, snow_depth_m=0.2))
    module.setup()
    expected = "materials.snow_depth_m: received 0.2, expected 0, because this ground is not a"
    with pytest.raises(InvalidInputError, match=expected):
        module.step_batch(World(ground=ground, stage_hash="stage"), None, randomness.stream(1, "m"))
