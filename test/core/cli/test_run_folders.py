"""A folder for output has one command that writes to it."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from oaisys_core.cli.main import app
from oaisys_core.files.folders import own_folder

WORLD = {
    "backend": "analytic",
    "stage": {"surroundings": "plain", "preset": "mounds", "extent_m": 12.0, "resolution_px": 33},
    "materials": {"texture_size_px": 16, "mask": {"size_px": 16}},
    "sensors": {
        "cameras": [{"name": "camera", "width_px": 16, "height_px": 12, "fx_px": 14, "fy_px": 14}]
    },
    "render": {"quality": "geometry"},
}


@pytest.mark.parametrize("more", [[], ["--resume"]])
def test_a_folder_that_another_command_writes_to_is_refused(
    tmp_path: Path, more: list[str]
) -> None:
    config = tmp_path / "world.yaml"
    config.write_text(yaml.safe_dump(WORLD), encoding="utf-8")
    arguments = ["render", "--config", str(config), "--out", str(tmp_path / "out"), *more]
    with own_folder(tmp_path / "out"):
        refused = CliRunner().invoke(app, arguments)
        assert refused.exit_code != 0
        assert "another command is writing to it" in str(refused.exception)
        assert list((tmp_path / "out").iterdir()) == []


def test_a_configuration_that_is_refused_leaves_no_folder(tmp_path: Path) -> None:
    config = tmp_path / "world.yaml"
    world = {**WORLD, "render": {"passes": ["disparity"]}}
    config.write_text(yaml.safe_dump(world), encoding="utf-8")
    out = tmp_path / "a" / "out"
    refused = CliRunner().invoke(app, ["render", "--config", str(config), "--out", str(out)])
    assert "render.passes.0: received 'disparity'" in str(refused.exception)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("link", ["batch_0002", "batch_0001/camera"])
def test_a_run_is_not_continued_through_a_link(tmp_path: Path, link: str) -> None:
    config, out, elsewhere = tmp_path / "world.yaml", tmp_path / "out", tmp_path / "elsewhere"
    config.write_text(yaml.safe_dump(WORLD), encoding="utf-8")
    run = ["render", "--config", str(config), "--out", str(out), "--backend", "analytic"]
    assert CliRunner().invoke(app, run).exit_code == 0
    elsewhere.mkdir()
    if (out / link).exists():
        (out / link).rename(out / f"{link}_before")
    (out / link).symlink_to(elsewhere)
    refused = CliRunner().invoke(app, [*run, "--batches", "2", "--resume"])
    assert "expected a folder or file of the run, not a link" in str(refused.exception)
    assert list(elsewhere.iterdir()) == []
