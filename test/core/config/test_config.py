"""Configuration files: faults are told by line, path and value; defaults are the paper's."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from oaisys_core.config import (
    SimulationConfig,
    adjust,
    config_from_mapping,
    config_sha256,
    load_config,
)
from oaisys_core.config.draw_checks import error_of
from oaisys_core.config.loading import with_lines
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.geometry import unproject
from oaisys_core.procedural.terrain.presets import PRESETS
from oaisys_core.types import FloatArray, PinholeIntrinsics
from oaisys_core.world.modules import SensorsModule


def write(folder: Path, text: str) -> Path:
    path = folder / "world.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_an_empty_file_is_the_default_world(tmp_path: Path) -> None:
    assert load_config(write(tmp_path, "")) == SimulationConfig()


def test_the_default_camera_is_the_papers() -> None:
    (sensor,) = SensorsModule(SimulationConfig().sensors).sensors
    K = sensor.intrinsics.K
    assert (sensor.intrinsics.width_px, sensor.intrinsics.height_px) == (640, 480)
    expected = np.array([(541.14, 0, 319.5), (0, 541.14, 239.5), (0, 0, 1)])
    assert np.array_equal(K, expected)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("stage:\n  extend_m: 4\n", (":2: ", "stage.extend_m", "unknown key")),
        ("seed: -3\n", (":1: ", "seed", "-3")),
        ("sensors:\n  cameras:\n  - width_px: 100000\n", (":3: ", "cameras.0.width_px", "100000")),
        ("sensors:\n  cameras:\n  - {fx_px: .nan}\n", ("fx_px", "finite")),
        ("sensors:\n  cameras: [{name: a}, {name: a}]\n", ("cameras", "differ")),
        ("assets:\n  rocks:\n  - size_m: [2, 1]\n", ("rocks.0.size_m", "[2, 1]")),
        ("materials:\n  layers: []\n", ("materials.layers",)),
        ("materials:\n  layers: [{label: a, semantic_id: 10}]\n", ("called both", "'a'", "'rock'")),
        ("materials:\n  layers: [{label: a, semantic_id: 70000}]\n", ("semantic_id", "70000")),
        ("materials:\n  layers: [{label: a, semantic_id: 1, folder: none}]\n", ("folder", "none")),
        ("- a\n", ("list", "mapping")),
        ("a: [\n", ("not YAML",)),
    ],
)
def test_faults_name_line_path_and_value(tmp_path: Path, text: str, parts: tuple[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, text))
    assert all(part in str(caught.value) for part in parts), str(caught.value)


CAMERA, LIDAR, IMU = (
    f"sensors:\n  {kind}:\n  - {{{{name: a, mount_quat_xyzw: {{0}}}}}}\n"
    for kind in ("cameras", "lidars", "imus")
)
WAYPOINTS = "waypoints_m: [[0, 0, 9], [1, 0, 9]]"
SPLINE = f"sensors:\n  motion: {{{{kind: spline, {WAYPOINTS}, quats_xyzw: [{{0}}, {{0}}]}}}}\n"
OBJECT, PRIMITIVE = (
    f"assets:\n  {kind}:\n  - {{{{{keys}, position_m: [0, 0, 0], quat_xyzw: {{0}}}}}}\n"
    for kind, keys in (
        ("objects", "name: a, shape: boulder, label: a, semantic_id: 9"),
        ("primitives", "shape: box, size_m: [1, 1, 1]"),
    )
)


@pytest.mark.parametrize("text", [CAMERA, LIDAR, IMU, SPLINE, OBJECT, PRIMITIVE])
def test_quaternions_typed_by_hand_are_accepted_and_others_refused(
    tmp_path: Path, text: str
) -> None:
    load_config(write(tmp_path, text.format("[0, 0.38, 0, 0.93]")))
    for bad in ("[0, 0, 0, 1.02]", "[0, 0, 0, 0.98]", "[0, 0, 0, 0]"):
        with pytest.raises(ConfigError, match=r"quats?_xyzw.*within 0\.01 of 1") as caught:
            load_config(write(tmp_path, text.format(bad)))
        assert bad[1:-1].split(", ")[-1] in str(caught.value)


def test_every_fault_is_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, "seed: x\nbackend: unreal\nstage: {resolution_px: 0}\n"))
    assert len(str(caught.value).splitlines()) == 3


def test_a_missing_file_is_a_config_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path / "nowhere.yaml")


def test_texture_folders_are_relative_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    layer = "materials:\n  layers: [{label: a, semantic_id: 1, folder: maps}]\n"
    config = load_config(write(tmp_path, layer))
    assert config.materials.layers[0].folder == (tmp_path / "maps").resolve()


def test_the_hash_depends_on_values_alone() -> None:
    plain = config_sha256(SimulationConfig())
    assert plain == config_sha256(config_from_mapping({"seed": 1, "backend": "blender"}))
    assert plain != config_sha256(config_from_mapping({"seed": 2}))


def test_a_record_of_other_generators_is_refused_by_name() -> None:
    record = SimulationConfig().model_dump(mode="json")
    assert config_sha256(config_from_mapping(record)) == config_sha256(SimulationConfig())
    record["generator_version"] -= 1
    with pytest.raises(ConfigError, match=r"generator_version: received 27, expected 28, because"):
        config_from_mapping(record)


def test_a_sphere_may_be_given_by_its_radius() -> None:
    sphere = {"shape": "sphere", "radius_m": 2.0, "position_m": [0, 0, 3]}
    config = config_from_mapping({"assets": {"primitives": [sphere]}})
    assert config.assets.primitives[0].size_m == (2.0, 2.0, 2.0)


def directions(camera: PinholeIntrinsics, pixels: list[tuple[float, float]]) -> FloatArray:
    return unproject(np.array(pixels), np.ones(len(pixels)), camera)


def intrinsics_of(config: SimulationConfig, size: str | None) -> PinholeIntrinsics:
    return SensorsModule(adjust(config, size=size).sensors).sensors[0].intrinsics


def test_resizing_keeps_what_a_camera_sees() -> None:
    config = config_from_mapping({"sensors": {"cameras": [{"cx_px": 300.0, "fy_px": 500.0}]}})
    before, after = intrinsics_of(config, None), intrinsics_of(config, "320x240")
    corners = directions(before, [(-0.5, -0.5), (639.5, 479.5)])
    assert np.allclose(corners, directions(after, [(-0.5, -0.5), (319.5, 239.5)]))


@pytest.mark.parametrize("height_px", [90, 240, 400])
def test_another_aspect_keeps_the_width_of_the_view_and_the_shape_of_pixels(height_px: int) -> None:
    config = config_from_mapping({"sensors": {"cameras": [{"cx_px": 300.0, "fy_px": 500.0}]}})
    before, after = intrinsics_of(config, None), intrinsics_of(config, f"320x{height_px}")
    left_right = directions(before, [(-0.5, 239.5), (639.5, 239.5)])
    middle_px = (height_px - 1) / 2
    np.testing.assert_allclose(
        directions(after, [(-0.5, middle_px), (319.5, middle_px)]), left_right, atol=1e-12
    )
    assert after.fx_px / after.fy_px == pytest.approx(before.fx_px / before.fy_px)


def test_adjusting_with_the_same_values_keeps_the_hash() -> None:
    config = SimulationConfig()
    same = adjust(config, seed=1, backend="blender", quality="standard")
    assert config_sha256(same) == config_sha256(config)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ({"stage": {"extent_m": True}}, "stage: extent_m is True"),
        ({"assets": {"rocks": [{"count": [False, 2]}]}}, r"assets.rocks.0: count is \[False, 2\]"),
    ],
)
def test_a_truth_value_is_no_number(data: dict[str, Any], told: str) -> None:
    """YAML reads `yes` and `on` as true, which counted as 1."""
    with pytest.raises(ConfigError, match=told):
        config_from_mapping(data)


@pytest.mark.parametrize(
    ("section", "path"),
    [
        ('materials: {layers: [{texture: mud, label: "%s", semantic_id: 1}]}', "layers.0.label"),
        ('assets: {rocks: [{kind: boulder, label: "%s", semantic_id: 3}]}', "rocks.0.label"),
        ('environment: {sky_label: "%s", sky_semantic_id: 4}', "sky_label"),
    ],
)
@pytest.mark.parametrize("label", [r"a\0b", r"a\eb", r"a\nb", "x" * 2000])
def test_labels_that_no_data_set_can_hold_are_refused(
    tmp_path: Path, section: str, path: str, label: str
) -> None:
    with pytest.raises(ConfigError, match="in a line, without control characters") as refused:
        load_config(write(tmp_path, section % label))
    assert path in str(refused.value)
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize(
    ("data", "model"),
    [
        ({"stage": {"body": "moon"}}, "none"),
        ({"stage": {"body": 1.7374e6}, "environment": {"sun_elevation_deg": 9}}, "none"),
        ({"stage": {"body": "mars"}}, "plain"),
        (
            {"stage": {"body": "mars"}, "environment": {"sky": {"model": "atmosphere"}}},
            "atmosphere",
        ),
        ({"stage": {"body": "earth"}}, "atmosphere"),
        ({"stage": {"body": 5e6}}, "atmosphere"),
    ],
)
def test_without_a_sky_of_its_own_a_world_has_that_of_its_body(
    data: dict[str, Any], model: str
) -> None:
    config = config_from_mapping(data)
    assert config.environment.sky.model == model
    assert config_from_mapping(config.model_dump()) == config


@pytest.mark.parametrize(
    ("data", "layers", "rocks"),
    [
        ({"stage": {"body": "moon"}}, ["regolith"], "basalt"),
        ({"stage": {"body": 3.3895e6}}, ["red_sand", "gravel_dark"], "basalt"),
        ({"stage": {"preset": "plane"}}, ["gravel", "sand"], "rock"),
        ({"stage": {"preset": "canyon"}}, ["gravel", "sand", "bedrock"], "rock"),
        ({"stage": {"preset": "dunes"}}, ["sand", "rippled_sand"], "rock"),
        ({"stage": {"preset": "volcanic_field"}}, ["lava", "gravel_dark"], "basalt"),
        ({"stage": {"preset": "dunes", "body": "mars"}}, ["red_sand", "gravel_dark"], "basalt"),
        (
            {
                "stage": {"preset": "mesa"},
                "materials": {"layers": [{"texture": "ice", "label": "ice", "semantic_id": 1}]},
            },
            ["ice"],
            "rock",
        ),
        ({"stage": {"body": "moon"}, "assets": {"rock_texture": "lava"}}, ["regolith"], "lava"),
        (
            {
                "stage": {"body": "mars"},
                "materials": {"layers": [{"texture": "ice", "label": "ice", "semantic_id": 1}]},
            },
            ["ice"],
            "basalt",
        ),
        (
            {
                "stage": {"body": "moon"},
                "materials": {
                    "pools": [{"layers": [{"texture": "ice", "label": "ice", "semantic_id": 1}]}]
                },
            },
            [],
            "basalt",
        ),
    ],
)
def test_without_a_ground_of_its_own_a_world_has_that_of_its_body_and_preset(
    data: dict[str, Any], layers: list[str], rocks: str
) -> None:
    config = config_from_mapping(data)
    assert [layer.texture for layer in config.materials.layers] == layers
    assert config.assets.rock_texture == rocks
    assert config_from_mapping(config.model_dump()) == config


def test_default_layers_of_all_stages_have_one_id_for_each_name() -> None:
    stages = [{"body": body} for body in ("moon", "mars")] + [{"preset": each} for each in PRESETS]
    layers = [
        layer
        for stage in stages
        for layer in config_from_mapping({"stage": stage}).materials.layers
    ]
    pairs = {(layer.label, layer.semantic_id) for layer in layers}
    assert len(pairs) == len({name for name, _ in pairs}) == len({number for _, number in pairs})


def test_the_sky_of_mars_is_brighter_and_redder_at_the_horizon() -> None:
    sky = config_from_mapping({"stage": {"body": "mars"}}).environment.sky
    assert sky.horizon_srgb > sky.zenith_srgb
    assert all(red > blue for red, _, blue in (sky.horizon_srgb, sky.zenith_srgb))


def test_a_body_that_is_not_valid_is_refused_where_it_stands() -> None:
    with pytest.raises(ConfigError, match=r"stage\.body"):
        config_from_mapping({"stage": {"body": "venus"}})


def test_ranges_of_things_take_single_numbers() -> None:
    rocks = [{"count": 300, "size_m": 0.5, "sink": 0.2}, {"cover": 0.03}]
    group = {"name": "a", "shape": "birch", "label": "tree", "semantic_id": 3}
    groups = [{**group, "count": 5, "size_m": 3, "sink": 0.1}]
    assets = config_from_mapping({"assets": {"rocks": rocks, "groups": groups}}).assets
    assert (assets.rocks[0].count, assets.rocks[0].size_m) == ((300, 300), (0.5, 0.5))
    assert (assets.rocks[0].sink, assets.rocks[1].cover) == ((0.2, 0.2), (0.03, 0.03))
    assert (assets.groups[0].count, assets.groups[0].sink) == ((5, 5), (0.1, 0.1))


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("count", "many", r"a number or \[least, most\]"),
        ("count", 1.5, "a whole number"),
        ("count", [5, 3], r"\[least, most\]"),
        ("cover", 0.9, "a number of at most 0.5"),
        ("sink", 2, "a number of at most 1"),
        ("size_m", -1, "the least at least 0"),
    ],
)
def test_other_numbers_of_things_are_refused(key: str, value: Any, expected: str) -> None:
    with pytest.raises(ConfigError, match=rf"assets\.rocks\.0\.{key}: received .*{expected}"):
        config_from_mapping({"assets": {"rocks": [{key: value}]}})


@pytest.mark.parametrize("key", ["9" * 5000, "\u00b2"])
def test_digits_that_are_no_index_are_a_key(tmp_path: Path, key: str) -> None:
    file = tmp_path / "config.yaml"
    file.write_text("seed: 1\n")
    assert with_lines(file, [f"seed.{key}: wrong"]) == [f"{file}:1: seed.{key}: wrong"]
    (fault,) = error_of(InvalidInputError(f"stage.{key}", 1, "none")).errors()
    assert fault["loc"] == ("stage", key)
