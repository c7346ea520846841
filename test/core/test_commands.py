"""The shell commands, run as a user runs them."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from oaisys_core.config import SimulationConfig, config_from_mapping, load_config

REPOSITORY = Path(__file__).parents[2]
SMALL = """
backend: analytic
stage: {extent_m: 16, resolution_px: 33}
materials: {texture_size_px: 64, mask: {size_px: 32}}
assets: {rocks: []}
sensors: {cameras: [{width_px: 32, height_px: 24}]}
"""


def oaisys(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "oaisys_core", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL, encoding="utf-8")
    return path


def test_render_writes_the_batches_and_samples_asked_for(small: Path, tmp_path: Path) -> None:
    result = oaisys(
        "render", "--config", small, "--out", tmp_path, "--batches", "2", "--samples", "2"
    )
    assert result.returncode == 0, result.stderr
    assert len(list(tmp_path.glob("batch_000[12]/camera/000[12]camera_rgb_00.png"))) == 4
    poses = tmp_path / "batch_0001" / "poses.csv"
    again = tmp_path / "again"
    result = oaisys("render", "--config", small, "--out", again, "--poses", poses)
    assert result.returncode == 0, result.stderr
    name = "batch_0001/camera/0001camera_pinhole_depth_00.exr"
    assert (again / name).read_bytes() == (tmp_path / name).read_bytes()


@pytest.mark.parametrize(
    ("text", "arguments", "parts"),
    [
        ("stage: {extend_m: 3}", [], ["small.yaml:1", "stage.extend_m", "unknown key"]),
        (SMALL, ["--backend", "unreal"], ["backend", "unreal", "analytic"]),
        (SMALL, ["--size", "8"], ["size", "8", "WIDTHxHEIGHT"]),
        (SMALL, ["--poses", "nowhere.csv"], ["poses", "nowhere.csv"]),
    ],
)
def test_wrong_input_is_exit_2_without_a_traceback(
    small: Path, tmp_path: Path, text: str, arguments: list[str], parts: list[str]
) -> None:
    small.write_text(text, encoding="utf-8")
    result = oaisys("render", "--config", small, "--out", tmp_path / "out", *arguments)
    assert result.returncode == 2
    assert all(part in result.stderr for part in parts), result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


def test_config_check(small: Path) -> None:
    assert oaisys("config", "check", small).returncode == 0
    small.write_text("seed: -1", encoding="utf-8")
    assert oaisys("config", "check", small).returncode == 2


def test_config_show_prints_a_config_that_is_read_back() -> None:
    shown = yaml.safe_load(oaisys("config", "show").stdout)
    assert config_from_mapping(shown) == SimulationConfig()


@pytest.mark.parametrize(
    "path", [REPOSITORY / "config/simulator.yaml", *REPOSITORY.glob("config/examples/*.yaml")]
)
def test_the_examples_are_valid(path: Path) -> None:
    load_config(path)


def test_the_documented_default_is_the_default() -> None:
    assert load_config(REPOSITORY / "config/simulator.yaml") == SimulationConfig()
