"""`oaisys config check` knows every name that a render knows, and which was probably meant."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

import pytest
from commands import oaisys_here
from repository import REPOSITORY
from typer.testing import CliRunner

from oaisys_core.cli.main import app, main
from oaisys_core.cli.rendering.metadata_file import load_steps
from oaisys_core.config import config_from_mapping
from oaisys_core.errors import InvalidInputError
from oaisys_core.simulation import Simulation
from oaisys_core.world.config_files import name_faults

CONFIG = REPOSITORY / "config"


ADDED = "label: a, semantic_id: 9, position_m: [0, 0, 0]"
PLACE = f"name: a, {ADDED}"

WRONG = [
    ("stage: {preset: mound}", "stage.preset", "mounds"),
    (
        "materials: {layers: [{texture: gravl, label: a, semantic_id: 1}]}",
        "materials.layers.0.texture",
        "gravel",
    ),
    ("assets: {rock_texture: basal}", "assets.rock_texture", "basalt"),
    ("assets: {rocks: [{kind: bolder}]}", "assets.rocks.0.kind", "boulder"),
    (
        f"assets: {{objects: [{{shape: rovr, {PLACE}}}]}}",
        "assets.objects.0.shape",
        "rover",
    ),
    ("sensors: {cameras: [{modalities: [dept]}]}", "sensors.cameras.0.modalities.0", "depth"),
    ("render: {passes: [semantc_1]}", "render.passes.0", "semantic_1"),
    ("render: {passes: [disparity]}", "render.passes.0: received 'disparity'", None),
    ("render: {quality: geometry, passes: [rgb]}", "render.passes.0: received 'rgb'", None),
    ("render: {quality: standrd}", "render.quality", "standard"),
    ("environment: {effects: [{effect: rain}]}", "environment.effects.0.effect", None),
    ("extensions: {wind: {}}", "oaisys.modules", None),
    ("backend: blendr", "backend", "blender"),
    ("stage: {preset: MOUNDS}", "stage.preset", "mounds"),
    ("render: {quality: Standard}", "render.quality", "standard"),
    ("Stage: {preset: mounds}", "Stage", "stage"),
]


WITH_FERNS = {
    "backend": "analytic",
    "stage": {"preset": "plane", "extent_m": 8, "resolution_px": 17},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 32}},
    "assets": {
        "rocks": [],
        "groups": [
            {
                "name": "ferns",
                "shape": "angular",
                "label": "fern",
                "semantic_id": 5,
                "count": [1, 2],
            }
        ],
    },
    "sensors": {"cameras": [{"width_px": 16, "height_px": 12, "fx_px": 15, "fy_px": 15}]},
}


@pytest.mark.parametrize(("text", "path", "meant"), WRONG, ids=[each[1] for each in WRONG])
def test_a_name_that_is_not_there_is_refused_with_the_one_that_was_meant(
    text: str,
    path: str,
    meant: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "world.yaml"
    file.write_text(f"seed: 1\n{text}\n", encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["oaisys", "config", "check", str(file)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert path in said
    assert str(file) in said
    assert meant is None or f"did you mean {meant}?" in said
    assert "Traceback" not in said


def test_all_faults_are_told_at_once_each_with_its_line(tmp_path: Path) -> None:
    empty = tmp_path / "maps"
    empty.mkdir()
    file = tmp_path / "world.yaml"
    file.write_text(
        "stage:\n  preset: mound\nmaterials:\n  layers:\n"
        "  - {texture: forest_floor, label: a, semantic_id: 1}\n"
        "  - {folder: maps, label: b, semantic_id: 3}\n"
        "assets:\n  rocks: []\n  rock_texture: stone\n",
        encoding="utf-8",
    )
    ended = oaisys_here("config", "check", file)
    assert ended.returncode == 2
    for line, path in (
        (2, "stage.preset"),
        (5, "materials.layers.0.texture"),
        (6, "materials.layers.1.folder"),
        (9, "assets.rock_texture"),
    ):
        assert f"{file}:{line}: {path}: received" in ended.stderr


def test_a_file_that_holds_no_mesh_is_told(tmp_path: Path) -> None:
    (tmp_path / "ground.obj").write_text("v 0 0 0\n", encoding="utf-8")
    file = tmp_path / "world.yaml"
    file.write_text("stage: {mesh: {file: ground.obj}}\n", encoding="utf-8")
    ended = oaisys_here("config", "check", file)
    assert ended.returncode == 2
    assert "stage.mesh.file" in ended.stderr


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.gltf", '{"asset": []}', "asset must be an object, not []"),
        ("a.obj", "v 0 0\nv 1 0\nv 1 1\nf 1 2 3\n", "three coordinates"),
        ("a.stl", "solid a\nfacet normal 0 0 1\n", "outer after facet"),
    ],
)
def test_a_malformed_mesh_is_told_without_a_traceback(
    tmp_path: Path, name: str, text: str, told: str
) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    file = tmp_path / "world.yaml"
    file.write_text(f"stage: {{mesh: {{file: {name}}}}}\n", encoding="utf-8")
    ended = oaisys_here("config", "check", file)
    assert ended.returncode == 2
    assert "stage.mesh.file: received" in ended.stderr
    assert told in ended.stderr
    assert "Traceback" not in ended.stderr


def test_examples_and_defaults_have_no_faults() -> None:
    assert name_faults(config_from_mapping({})) == []
    for name in ("stage_mesh", "stage_dem", "environment_hdri", "materials_label_image"):
        ended = oaisys_here("config", "check", CONFIG / "examples" / f"{name}.yaml")
        assert ended.returncode == 0, ended.stderr
        assert "valid" in ended.stdout


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["rendr"], "render"),
        (["RENDER"], "render"),
        (["audti"], "audit"),
        (["config", "chek"], "check"),
        (["config", "CHECK"], "check"),
        (["serve", "--legacy-pose-policy", "rejct"], "reject"),
        (["explore", "--via", "Trajectory"], "trajectory"),
    ],
    ids=" ".join,
)
def test_a_command_or_choice_that_was_probably_meant_is_named(
    arguments: list[str], meant: str
) -> None:
    ended = CliRunner().invoke(app, arguments)
    assert ended.exit_code == 2
    assert f"(did you mean {meant}?)" in ended.output


def test_an_option_that_was_probably_meant_is_named() -> None:
    ended = CliRunner().invoke(app, ["render", "--qualty", "high"])
    assert ended.exit_code == 2
    assert "--quality" in ended.output


@pytest.mark.parametrize(
    ("option", "value", "meant"),
    [
        ("--quality", "standrd", "standard"),
        ("--quality", "HIGH", "high"),
        ("--backend", "blendr", "blender"),
    ],
)
def test_a_value_of_an_option_that_was_probably_meant_is_named(
    option: str, value: str, meant: str, tmp_path: Path
) -> None:
    ended = CliRunner().invoke(app, ["render", "--out", str(tmp_path / "out"), option, value])
    assert isinstance(ended.exception, InvalidInputError)
    assert ended.exception.expected.endswith(f"(did you mean {meant}?)")


def step_through(file: Path) -> None:
    """Step a small world as a file of metadata says."""
    steps = load_steps(file)
    with closing(Simulation(config_from_mapping(WITH_FERNS))) as simulation:
        simulation.step_batch(steps.batch)
        for sample in steps.samples:
            simulation.step_sample(
                sample.metadata, modalities=sample.modalities, sensors=sample.sensors
            )


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("sampels: []", "samples"),
        ("[{modalites: [depth]}]", "modalities"),
        ("[{modalities: [dept]}]", "depth"),
        ("[{sensors: [CAMERA]}]", "camera"),
        ("[{enviroment: {}}]", "environment"),
        ("[{sensor: {pose_policy: rejct}}]", "reject"),
        ("{batch: {sensor: {motion: {kind: hovr}}}}", "hover"),
        ("[{environment: {sun_elevation: 5}}]", "sun_elevation_deg"),
        ("{batch: {stage: {preset: MOUNDS}}}", "mounds"),
        ("{batch: {asset: {groups: {fern: {hidden: true}}}}}", "ferns"),
        (f"[{{asset: {{add: {{extra: {{prototype: fernz, {ADDED}}}}}}}}}]", "ferns"),
    ],
)
def test_a_name_in_a_file_of_metadata_is_refused_with_the_one_that_was_meant(
    text: str, meant: str, tmp_path: Path
) -> None:
    file = tmp_path / "steps.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInputError) as found:
        step_through(file)
    assert found.value.expected.endswith(f"(did you mean {meant}?)")
