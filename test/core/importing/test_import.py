"""Original configurations become ours: no key is lost, units, axes and angles are right."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from original_config import Json, document, online, space, write
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from oaisys_core.cli.main import app
from oaisys_core.config import SimulationConfig, adjust, config_from_mapping, load_config
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.importing.document import key_paths
from oaisys_core.importing.frames import blender_rotation, mount, rig_pose
from oaisys_core.importing.importer import import_file
from oaisys_core.importing.key_outcomes import outcome_of
from oaisys_core.output.poses import read_poses
from oaisys_core.simulation import Simulation
from oaisys_core.types import Pose
from oaisys_core.world.config_files import name_faults

MODES: dict[str, Callable[[], Json]] = {"ground": document, "space": space}
FILES = {**MODES, "online": online}


def imported(data: Json, folder: Path, **options: Any) -> Json:
    return import_file(write(data, folder), **options).config


def outcome(data: Json, folder: Path) -> tuple[Json, tuple[str, ...]]:
    found = import_file(write(data, folder))
    return found.config, found.warnings


@pytest.mark.parametrize("name", FILES)
def test_the_imported_file_is_valid_and_says_what_became_of_every_key(
    name: str, tmp_path: Path
) -> None:
    data = FILES[name]()
    found = import_file(write(data, tmp_path))
    assert set(found.outcomes) == set(key_paths(data))
    assert all(outcome_of(path) is not None for path in key_paths(data))
    text = found.text("original.json")
    assert yaml.safe_load(text) == found.config
    for path, outcome in found.outcomes.items():
        assert outcome.kind == "mapped" or f"{path}: {outcome.kind}" in text
    config_from_mapping(found.config)


def changed(value: Any) -> Any:
    """Return another value of the same form."""
    others = {
        "VORONOI": "CLOUDS",
        "NOR": "GLOB_Z",
        "GLOBAL": "LOCAL",
        "dunes": "canyon",
        "randomEuclideanTarget": "randomEuclidean",
        "centeredTarget": "randomEuclidean",
        "trajectory_simulation": [9.0, 8.0, 7.0],
    }
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1 if value < 1 else value * 0.75 if isinstance(value, float) else value + 1
    if isinstance(value, str):
        return others.get(value, value + "x")
    if isinstance(value, list) and len(value) == 3 and value == [1, 0, 1]:
        return [0, 1, 1]
    if isinstance(value, list) and value == [1]:
        return [0]
    if isinstance(value, list) and len(value) == 7:
        return [0.5, 0.2, 0.3, 0, 0, 0, 1]
    return [changed(entry) for entry in value]


def leaves(node: Any, at: str = "") -> Iterator[tuple[str, Any, Any, Any]]:
    if isinstance(node, dict):
        for key, value in node.items():
            path = f"{at}.{key}".removeprefix(".")
            nested = isinstance(value, dict) or (
                isinstance(value, list) and value and all(isinstance(v, dict) for v in value)
            )
            if nested:
                yield from leaves(value, path)
            elif value not in ("", [], {}):
                yield path, node, key, value
    elif isinstance(node, list):
        for entry in node:
            yield from leaves(entry, at)


DEPENDENT = {
    "ASSET_SETUP.MATERIALS.materialParams.general.minNumMixTerrains": "see the test of counts",
    "ASSET_SETUP.MESHES.meshParams.numberInstances": "only without a density map",
    "SENSOR_SETUP.GENERAL.hoverBaseDistanceNoise": "only that it is there",
    "ENVIRONMENT_EFFECTS_SETUP.ENVIRONMENT_EFFECTS.environmentEffectsParams.stepInterval": "LOCAL",
    "SENSOR_SETUP.GENERAL.targetObject": "there is one body",
    "ASSET_SETUP.MATERIALS.name": "there is one material",
    "ASSET_SETUP.MATERIALS.type": "both kinds have the same keys",
    "ASSET_SETUP.MESHES.meshParams.meshInstanceName": "only where the file is there",
    "ASSET_SETUP.STAGES.stageParams.assetMaterial": "there is one material",
    "ASSET_SETUP.MESHES.meshParams.assetMaterial": "there is one material",
    "SENSOR_SETUP.GENERAL.finalApproachDistance": "only when landing",
    "RENDER_SETUP.RENDER_PASSES.passParams.numIter": "only of labels",
    "ASSET_SETUP.MESHES.meshParams.densityMapSettings.densityMap.colorStopColor_0": "a ramp",
    "ASSET_SETUP.MESHES.meshParams.densityMapSettings.densityMap.colorStopColor_1": "a ramp",
}
"""Mapped keys whose value alone changes nothing in these files; each has a test below."""

SPACE_ONLY = ("SENSOR_SETUP.GENERAL", "ASSET_SETUP.MESHES")


@pytest.mark.parametrize("name", MODES)
def test_what_is_mapped_changes_the_result_and_what_is_not_does_not(
    name: str, tmp_path: Path
) -> None:
    base = outcome(MODES[name](), tmp_path)
    wrong = []
    for path, _, _, _ in leaves(MODES[name]()):
        if path in DEPENDENT or (name == "space" and not path.startswith(SPACE_ONLY)):
            continue
        if name == "space" and ("hoverBase" in path or "labelIDVec" in path):
            continue  # nothing to hover over; the body's material has the labels
        rule = outcome_of(path)
        assert rule is not None, path
        data = MODES[name]()
        for other, node, key, value in leaves(data):
            if other == path:
                node[key] = changed(value)
                break
        if (outcome(data, tmp_path) != base) != (rule.kind == "mapped"):
            wrong.append((path, rule))
    assert not wrong


def test_the_camera_keeps_its_matrix_and_passes(tmp_path: Path) -> None:
    (camera,) = imported(document(), tmp_path)["sensors"]["cameras"]
    expected = {"fx_px": 50.0, "fy_px": 51.0, "cx_px": 32.5, "cy_px": 22.5}
    assert {key: camera[key] for key in expected} == expected
    assert camera["modalities"] == ["rgb", "depth", "semantic_0", "semantic_2", "instance"]
    assert camera["name"] == "eye_1"
    assert camera["lens"]["f_number"] == 2.0


@pytest.mark.parametrize("seed", range(5))
def test_mounts_look_where_blenders_camera_looks(seed: int) -> None:
    """Blender's camera looks along its -z, its +y is up in the image; so does its base."""
    turn = Rotation.random(random_state=seed)
    x, y, z, w = turn.as_quat()
    pose = mount([0.3, 0.4, 0.5, w, x, y, z])
    link = Rotation.from_quat(pose.quat_xyzw)

    def in_body(v: np.ndarray) -> np.ndarray:
        right, up, back = v
        return np.array([-back, -right, up])

    assert np.allclose(link.apply([1, 0, 0]), in_body(turn.apply([0, 0, -1])))
    assert np.allclose(link.apply([0, 0, 1]), in_body(turn.apply([0, 1, 0])))
    assert np.allclose(pose.position_m, (-0.5, -0.3, 0.4))
    rig = rig_pose([1.0, 2.0, 3.0, w, x, y, z])
    assert rig.position_m == (1.0, 2.0, 3.0)
    body = Rotation.from_quat(rig.quat_xyzw)
    assert np.allclose(body.apply([1, 0, 0]), turn.apply([0, 0, -1]))
    assert np.allclose(body.apply([0, 0, 1]), turn.apply([0, 1, 0]))


def test_a_camera_with_a_quaternion_of_zeros_looks_at_its_target(tmp_path: Path) -> None:
    """Blender takes zeros for half a turn about x; the base of centeredTarget looks along +z."""
    assert np.allclose(blender_rotation([0, 0, 0, 0]), np.diag([1, -1, -1]))
    (camera,) = imported(space(), tmp_path)["sensors"]["cameras"]
    forward = Rotation.from_quat(camera["mount_quat_xyzw"]).apply([1, 0, 0])
    assert np.allclose(forward, (1, 0, 0))


def test_poses_from_a_file_are_turned(tmp_path: Path) -> None:
    data = document()
    general = data["SENSOR_SETUP"]["GENERAL"]
    general["sensorMovementType"] = "deterministic"
    general["sensorMovementPose"] = "path.csv"
    general["deterministicSensorOffsetPos"] = [0, 0, 5]
    (tmp_path / "path.csv").write_text("1, 1.0, 2.0, 3.0, 1.0, 0, 0, 0\n2, 0, 0, 0, 0, 0, 0, 1\n")
    out = tmp_path / "ours.yaml"
    found = import_file(write(data, tmp_path), tmp_path, out)
    assert found.config["sensors"]["motion"]["offset_m"] == [0, 0, 5]
    first, second = read_poses(Path(found.config["sensors"]["motion"]["path"]))
    assert first.position_m == (1.0, 2.0, 3.0)
    down = Rotation.from_quat(first.quat_xyzw)
    assert np.allclose(down.apply([1, 0, 0]), (0, 0, -1))
    assert np.allclose(down.apply([0, 0, 1]), (0, 1, 0))
    assert np.allclose(Rotation.from_quat(second.quat_xyzw).apply([0, 0, 1]), (0, -1, 0))
    (tmp_path / "path.csv").write_text("1, 1.0\n")
    with pytest.raises(ConfigError, match=r"path\.csv:1"):
        import_file(write(data, tmp_path), tmp_path, out)


def test_heights_vary_only_where_the_original_lets_them(tmp_path: Path) -> None:
    motion = imported(document(), tmp_path)["sensors"]["motion"]
    assert motion["height_above_ground_m"] == [1.0, 3.0]
    assert motion["target_above_ground_m"] == 0.25
    assert motion["position_m"] == [[-4.0, 4.0], [-5.0, 5.0], [1.0, 2.0]]
    assert motion["roll_deg"] == [-3.0, 4.0]
    data = document()
    del data["SENSOR_SETUP"]["GENERAL"]["hoverBaseDistanceNoise"]
    assert imported(data, tmp_path)["sensors"]["motion"]["height_above_ground_m"] == [2.0, 3.0]


def test_landing_ends_at_its_distance(tmp_path: Path) -> None:
    data = space()
    data["SENSOR_SETUP"]["GENERAL"]["landingMode"] = True
    motion = imported(data, tmp_path)["sensors"]["motion"]
    assert motion["distance_m"] == [500.0, 750.0]
    assert motion["approach"] == {"distance_m": pytest.approx(275.0), "steps": 3}


def test_the_sun_is_turned_from_clockwise_off_north(tmp_path: Path) -> None:
    air = imported(document(), tmp_path)["environment"]
    assert air["sun_azimuth_deg"] == [30.0, 60.0]
    assert air["sun_elevation_deg"] == [10.0, 20.0]
    assert air["sun_angular_diameter_deg"] == [0.5, 0.5]
    assert (air["redraw"], air["step_interval"]) == ("sample", 3)
    data = document()
    (effect,) = data["ENVIRONMENT_EFFECTS_SETUP"]["ENVIRONMENT_EFFECTS"]
    effect["environmentEffectsParams"]["stepIntervalOption"] = "LOCAL"
    assert imported(data, tmp_path)["environment"]["step_interval"] == 5


def test_textures(tmp_path: Path) -> None:
    (pool,) = imported(document(), tmp_path)["materials"]["pools"]
    assert (pool["count"], pool["replacement"]) == ([1, 2], True)
    (layer,) = pool["layers"]
    assert layer["tile_m"] == 4.0
    assert layer["displacement_m"] == [0.08, 0.08]
    assert layer["normal_strength"] == 0.75
    assert (layer["anti_tiling"], layer["rotation_deg"]) == ("voronoi", 45.0)
    assert layer["color"]["hue_deg"] == pytest.approx(18.0)
    assert [layer["semantic_id"], *(level["semantic_id"] for level in layer["levels"])] == [
        11,
        12,
        0,
    ]
    data = document()
    general = data["ASSET_SETUP"]["MATERIALS"][0]["materialParams"]["general"]
    general["minNumMixTerrains"] = general["maxNumMixTerrains"] = -1
    (pool,) = imported(data, tmp_path)["materials"]["pools"]
    assert pool["count"][0] >= len(pool["layers"])


def test_templates_maps_and_label_images_are_found_below_the_assets(tmp_path: Path) -> None:
    folder = tmp_path / "maps/red_sand"
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "red_sand_diff.png"), np.full((8, 8, 3), 90, np.uint8))
    cv2.imwrite(str(folder / "mask.png"), np.full((8, 8), 10, np.uint8))
    (folder / "red_sand.json").write_text(json.dumps({"path": "maps/red_sand/", "size": 5.0}))
    data = document()
    (entry,) = data["ASSET_SETUP"]["MATERIALS"][0]["materialParams"]["terrainTextureList"]
    del entry["path"], entry["size"]
    entry["templatePath"] = "maps/red_sand/red_sand.json"
    table = {"1": [[10, 10, 10], [100]]}
    mask = {"filePath": "maps/red_sand/mask.png", "mappingTable": table}
    entry["passParams"]["semantic_label"]["labelIDVec"] = [[mask, 12]]
    config = config_from_mapping(imported(data, tmp_path, assets_folder=tmp_path))
    (layer,) = config.materials.pools[0].layers
    assert layer.folder == folder.resolve()
    assert layer.tile_m == (8.0, 8.0)
    assert layer.labels_from is not None
    assert layer.labels_from.mapping["#0a0a0a"].semantic_ids == (100, 12)


def test_rocks(tmp_path: Path) -> None:
    (group,) = imported(document(), tmp_path)["assets"]["groups"]
    assert group["count"] == [20, 30]
    assert group["size_m"] == [0.5, 2.0]
    assert group["yaw_deg"] == [45.0, 135.0]
    assert group["tilt_deg"] == pytest.approx(18.0)
    (density,) = group["density"]
    assert density["cell_m"] == 10.0
    nearest = np.random.default_rng(0).uniform(0, 20, (8000, 3))
    points = np.random.default_rng(1).uniform(4, 16, (4000, 3))
    beyond = [(np.linalg.norm(nearest - p, axis=1).min() > 0.4) for p in points]
    assert density["cover"] == pytest.approx(np.mean(beyond), abs=0.03)
    data = document()
    settings = data["ASSET_SETUP"]["MESHES"][0]["meshParams"]["densityMapSettings"]["densityMap"]
    settings["colorStopColor_0"], settings["colorStopColor_1"] = (
        settings["colorStopColor_1"],
        settings["colorStopColor_0"],
    )
    (inverse,) = imported(data, tmp_path)["assets"]["groups"][0]["density"]
    assert inverse["cover"] == pytest.approx(1 - density["cover"])
    data["ASSET_SETUP"]["MESHES"][0]["meshParams"]["useDensityMap"] = False
    (group,) = imported(data, tmp_path)["assets"]["groups"]
    assert group["count"] == [1, 2]
    assert "density" not in group


def test_bodies_are_turned_as_blender_turns_them(tmp_path: Path) -> None:
    data = space()
    data["ASSET_SETUP"]["MESHES"][0]["meshParams"]["rotation_deg"] = [10, 20, 30]
    (body,) = imported(data, tmp_path)["assets"]["objects"]
    expected = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
    assert np.allclose(Rotation.from_quat(body["quat_xyzw"]).as_matrix(), expected)


def test_sky_images(tmp_path: Path) -> None:
    data = document()
    (effect,) = data["ENVIRONMENT_EFFECTS_SETUP"]["ENVIRONMENT_EFFECTS"]
    image, mask = tmp_path / "dawn.hdr", tmp_path / "mask.png"
    cv2.imwrite(str(image), np.ones((4, 8, 3), np.float32))
    cv2.imwrite(str(mask), np.zeros((4, 8, 3), np.uint8))
    table = {"1": [[0, 0, 0], [800]]}
    entry = {"filePath": "mask.png", "mappingTable": table}
    effect["type"] = "EnvHDRI"
    effect["environmentEffectsParams"] = {
        "selectionOption": 2,
        "HDRIList": [{"filePath": "dawn.hdr", "strength": [1.0], "labelIDVec": [40, entry]}],
    }
    config = config_from_mapping(imported(data, tmp_path, assets_folder=tmp_path))
    hdri = config.environment.hdri
    assert hdri is not None
    assert hdri.choose == "shuffle"
    (found,) = hdri.images
    assert (found.file, found.semantic_id) == (image.resolve(), 40)
    (labels,) = found.labels_from
    assert labels.level == 1
    assert labels.mapping["#000000"].semantic_id == 800


def test_missing_files_are_told_or_refused(tmp_path: Path) -> None:
    found = import_file(write(document(), tmp_path))
    assert any("maps/red_sand" in text for text in found.warnings)
    assert any("meshes/rocks.blend" in text for text in found.warnings)
    path = write({**document(), "ENVIRONMENT_EFFECTS_SETUP": {}}, tmp_path)
    with pytest.raises(ConfigError, match="rocks"):
        import_file(path, tmp_path, strict=True)


def test_strictly_all_missing_files_are_told_and_what_would_help(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as without:
        imported(document(), tmp_path, strict=True)
    lines = str(without.value).splitlines()
    assert len(lines) == 2
    assert all("is missing: --strict needs --assets" in line for line in lines)
    with pytest.raises(ConfigError, match=f"expected it below {tmp_path}"):
        imported(document(), tmp_path, strict=True, assets_folder=tmp_path)


def test_a_material_folder_without_a_colour_map_is_told_and_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "maps" / "red_sand"
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "red_sand_rough.png"), np.full((8, 8), 200, np.uint8))
    found = import_file(write(document(), tmp_path), tmp_path)
    (layer,) = found.config["materials"]["pools"][0]["layers"]
    assert layer["texture"] == "sand"
    assert any("red_sand has no colour map" in warning for warning in found.warnings)
    with pytest.raises(ConfigError, match="red_sand has no colour map"):
        import_file(write(document(), tmp_path), tmp_path, strict=True)


def test_files_that_are_there_and_cannot_be_used_are_told(tmp_path: Path) -> None:
    """As after a clone without its large files: each holds a line of text."""
    for name in ("meshes/rocks.blend", "maps/red_sand/red_sand_diff.png"):
        file = tmp_path / name
        file.parent.mkdir(parents=True)
        file.write_text("a pointer to a large file", encoding="ascii")
    data = document()
    data["ASSET_SETUP"]["MESHES"][0]["meshParams"]["meshFilePath"] = "meshes/rocks.obj"
    (tmp_path / "meshes" / "rocks.obj").write_text("a pointer", encoding="ascii")
    out = tmp_path / "ours.yaml"
    arguments = ["config", "import", str(write(data, tmp_path)), "--assets", str(tmp_path)]
    ended = CliRunner().invoke(app, [*arguments, "--out", str(out)])
    assert ended.exit_code == 0, ended.output
    assert "red_sand has no colour map" in ended.output
    assert "warning: assets.groups.0.file" in ended.output
    refused = CliRunner().invoke(app, [*arguments, "--strict"])
    assert isinstance(refused.exception, ConfigError)


@pytest.mark.parametrize(("theirs", "ours"), [("GPU", "auto"), ("CPU", "cpu")])
def test_the_device_is_taken_over(theirs: str, ours: str, tmp_path: Path) -> None:
    data = document()
    data["RENDER_SETUP"]["GENERAL"]["renderDevice"] = theirs
    assert imported(data, tmp_path)["render"]["device"] == ours


def test_an_id_that_things_share_is_named_after_all_of_them(tmp_path: Path) -> None:
    data = document()
    layer = data["ASSET_SETUP"]["MATERIALS"][0]["materialParams"]["terrainTextureList"][0]
    layer["passParams"]["semantic_label"]["labelIDVec"] = [[30, 40, 5]]
    found = import_file(write(data, tmp_path))
    config = config_from_mapping(found.config)
    labels = config.materials.pools[0].layers[0]
    assert [labels.label, *(level.label for level in labels.levels)] == [
        "red_sand",
        "sky or red_sand",
        "red_sand_2",
    ]
    assert config.environment.sky_labels.label == "sky or red_sand"
    assert any("the id 40 is shared by sky, red_sand" in warning for warning in found.warnings)


def small(config: SimulationConfig) -> SimulationConfig:
    """The same on the analytic backend, with small ground and textures."""
    data = adjust(config, backend="analytic").model_dump()
    data["materials"]["texture_size_px"] = 64
    data["materials"]["mask"]["size_px"] = min(config.materials.mask.size_px, 128)
    data["stage"]["resolution_px"] = min(config.stage.resolution_px, 65)
    return SimulationConfig.model_validate(data)


@pytest.mark.parametrize("name", FILES)
def test_stand_ins_are_made_for_missing_files_and_render(name: str, tmp_path: Path) -> None:
    made = tmp_path / "made"
    found = import_file(write(FILES[name](), tmp_path), stand_ins=made)
    file = tmp_path / "world.yaml"
    file.write_text(found.text("original.json"), encoding="utf-8")
    config = load_config(file)
    assert name_faults(config) == []
    if name == "online":
        assert config.stage.mesh is not None
        assert config.stage.mesh.file == (made / "stages" / "ground.obj").resolve()
        assert config.stage.mesh.object is None
    elif name == "ground":
        assert (made / "maps" / "red_sand" / "red_sand_diff.png").is_file()
        assert config.assets.groups[0].file == (made / "meshes" / "rocks.obj").resolve()
    else:
        assert config.assets.objects[0].file == (made / "meshes" / "body.obj").resolve()
    with pytest.raises(InvalidInputError, match="none with --strict"):
        import_file(write(FILES[name](), tmp_path), stand_ins=made, strict=True)
    simulation = Simulation(small(config))
    simulation.step_batch()
    sample = simulation.step_sample(modalities=("rgb", "depth"))
    rgb, depth_m = (sample.frames[index].data for index in (0, 1))
    assert np.isfinite(depth_m).any()
    assert rgb.std() > 1


def test_the_online_mode_is_known_in_strict_mode(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as found:
        import_file(write(online(), tmp_path), strict=True)
    assert "onlineMode" not in str(found.value)  # only files are missing
    assert "stages/ground.blend" in str(found.value)


def test_unknown_keys_are_told_or_refused(tmp_path: Path) -> None:
    data = document()
    data["SIMULATION_SETUP"]["numBatchs"] = 2
    found = import_file(write(data, tmp_path))
    assert any("SIMULATION_SETUP.numBatchs" in line for line in found.notes())
    with pytest.raises(ConfigError, match="numBatchs"):
        import_file(write(data, tmp_path), strict=True)


@pytest.mark.parametrize("end", ["\n", "\r", "\v", "\f", "\x1c", "\x85", "\u2028", "\u2029"])
def test_no_key_of_the_file_becomes_a_setting(end: str, tmp_path: Path) -> None:
    base = import_file(write(document(), tmp_path)).config
    key = f"zz{end}seed: 666{end}variants: [{{name: evil, stage: {{preset: plane}}}}]{end}#"
    data = document()
    data["SIMULATION_SETUP"][key] = 1
    data["SENSOR_SETUP"]["SENSORS"].append({"type": f"x{end}seed: 666"})
    found = import_file(write(data, tmp_path))
    text = found.text(f"of{end}seed: 666")
    assert yaml.safe_load(text) == base
    assert all(len(line.splitlines()) == 1 for line in found.notes())
    (tmp_path / "ours.yaml").write_text(text, encoding="utf-8")
    assert load_config(tmp_path / "ours.yaml").seed == SimulationConfig().seed
    with pytest.raises(ConfigError) as refused:
        import_file(write(data, tmp_path), strict=True)
    assert "\nseed" not in str(refused.value)


@pytest.mark.parametrize("text", ["[]", "{", '{"a": 1}'])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "original.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"original\.json"):
        import_file(path)


@pytest.mark.parametrize("name", MODES)
def test_the_imported_file_renders(name: str, tmp_path: Path) -> None:
    data = copy.deepcopy(MODES[name]())
    path = tmp_path / "ours.yaml"
    path.write_text(import_file(write(data, tmp_path), out=path).text("x"), encoding="utf-8")
    simulation = Simulation(small(load_config(path)))
    simulation.step_batch()
    sample = simulation.step_sample()
    depth_m = sample.frame("eye_1", "depth").data
    assert np.isfinite(depth_m).any()
    if name == "space":
        ids = sample.frame("eye_1", "semantic_0").data
        assert ids[24, 32] == 11
        assert ids[0, 0] == 40
        assert 200 < depth_m[24, 32] < 700
    assert isinstance(sample.rig_pose, Pose)
