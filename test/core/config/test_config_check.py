"""`oaisys config check` knows every name that a render knows, and which was probably meant."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import oaisys
from repository import REPOSITORY
from typer.testing import CliRunner

from oaisys_core.cli.main import app
from oaisys_core.config import config_from_mapping
from oaisys_core.config.checking import name_faults

CONFIG = REPOSITORY / "config"


PLACE = "name: a, label: a, semantic_id: 9, position_m: [0, 0, 0]"

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
    ("render: {quality: standrd}", "render.quality", "standard"),
    ("environment: {effects: [{effect: rain}]}", "environment.effects.0.effect", None),
    ("extensions: {wind: {}}", "oaisys.modules", None),
    ("backend: blendr", "backend", "blender"),
]


@pytest.mark.long
@pytest.mark.parametrize(("text", "path", "meant"), WRONG, ids=[each[1] for each in WRONG])
def test_a_name_that_is_not_there_is_refused_with_the_one_that_was_meant(
    text: str, path: str, meant: str | None, tmp_path: Path
) -> None:
    file = tmp_path / "world.yaml"
    file.write_text(f"seed: 1\n{text}\n", encoding="utf-8")
    ended = oaisys("config", "check", file)
    assert ended.returncode == 2, ended.stdout
    assert path in ended.stderr
    assert str(file) in ended.stderr
    assert meant is None or f"did you mean {meant}?" in ended.stderr
    assert "Traceback" not in ended.stderr


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
    ended = oaisys("config", "check", file)
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
    ended = oaisys("config", "check", file)
    assert ended.returncode == 2
    assert "stage.mesh.file" in ended.stderr


def test_examples_and_defaults_have_no_faults() -> None:
    assert name_faults(config_from_mapping({})) == []
    for name in ("stage_mesh", "stage_dem", "environment_hdri", "materials_label_image"):
        ended = oaisys("config", "check", CONFIG / "examples" / f"{name}.yaml")
        assert ended.returncode == 0, ended.stderr
        assert "valid" in ended.stdout


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [(["rendr"], "render"), (["config", "chek"], "check"), (["audti"], "audit")],
)
def test_a_command_that_was_probably_meant_is_named(arguments: list[str], meant: str) -> None:
    ended = CliRunner().invoke(app, arguments)
    assert ended.exit_code == 2
    assert "Did you mean" in ended.output
    assert meant in ended.output
