"""The shell commands, run as a user runs them."""

import re
import time
from io import StringIO
from pathlib import Path

import pytest
import yaml
from commands import oaisys, oaisys_here
from original_config import document, write
from repository import REPOSITORY
from rich.console import Console
from waiting import wait_until

from oaisys_core.cli.rendering.progress import RenderProgress
from oaisys_core.config import SimulationConfig, config_from_mapping, load_config
from oaisys_core.output.poses import read_poses
from oaisys_core.types import Progress

SMALL = """
backend: analytic
stage: {surroundings: plain, extent_m: 16, resolution_px: 33}
materials: {texture_size_px: 64, mask: {size_px: 32}}
assets: {rocks: []}
sensors: {cameras: [{width_px: 32, height_px: 24}]}
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL, encoding="utf-8")
    return path


@pytest.mark.long
def test_render_writes_the_batches_and_samples_asked_for(small: Path, tmp_path: Path) -> None:
    result = oaisys(
        "render", "--config", small, "--out", tmp_path, "--batches", "2", "--samples", "2"
    )
    assert result.returncode == 0, result.stderr
    assert len(list(tmp_path.glob("batch_000[12]/camera/000[12]camera_rgb_00.png"))) == 4
    poses = tmp_path / "batch_0001" / "poses.csv"
    again = tmp_path / "again"
    result = oaisys_here("render", "--config", small, "--out", again, "--poses", poses)
    assert result.returncode == 0, result.stderr
    name = "batch_0001/camera/0001camera_pinhole_depth_00.exr"
    assert (again / name).read_bytes() == (tmp_path / name).read_bytes()


def test_no_silence_is_long_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    lines: list[str] = []

    def said() -> list[str]:
        lines.extend(capsys.readouterr().err.splitlines())
        return lines

    every_s = 0.2
    began_s = time.monotonic()
    with RenderProgress(2, 0, Console(file=StringIO()), every_s=every_s) as shown:
        shown.begin("world 1")
        shown(Progress("ground", 0.25))
        wait_until(lambda: len(said()) >= 2)
        shown.begin("world 1, view 1 of 2")
        wait_until(lambda: "view" in said()[-1])
        shown.view_done()
    assert re.fullmatch(r"world 1: ground, 25%, \d+ s", lines[0])
    assert re.fullmatch(r"world 1, view 1 of 2, \d+ s", lines[-1])
    assert len(lines) <= (time.monotonic() - began_s) / every_s + 1


def test_a_terminal_shows_a_bar_with_the_stage() -> None:
    screen = StringIO()
    with RenderProgress(4, 1, Console(file=screen, force_terminal=True, width=100)) as shown:
        shown.begin("world 1")
        shown(Progress("ground", 0.25))
        shown.view_done()
    assert "world 1: ground, 25%" in screen.getvalue()
    assert "2/4" in screen.getvalue()


@pytest.mark.long
def test_a_run_is_resumed_where_it_stood_and_never_written_over(
    small: Path, tmp_path: Path
) -> None:
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    run = ("render", "--config", small)
    assert oaisys_here(*run, "--out", whole, "--batches", "2", "--samples", "2").returncode == 0
    assert oaisys_here(*run, "--out", halves, "--batches", "1", "--samples", "2").returncode == 0
    refused = oaisys_here(*run, "--out", halves)
    assert refused.returncode == 2
    assert "--resume" in refused.stderr
    resumed = oaisys_here(*run, "--out", halves, "--batches", "2", "--samples", "2", "--resume")
    assert resumed.returncode == 0, resumed.stderr
    files = sorted(path.relative_to(whole) for path in whole.rglob("*.*") if path.is_file())
    assert files == sorted(p.relative_to(halves) for p in halves.rglob("*.*") if p.is_file())
    for file in files:
        if file.suffix in (".png", ".exr", ".csv"):
            assert (whole / file).read_bytes() == (halves / file).read_bytes(), file


@pytest.mark.long
def test_metadata_of_each_sample_comes_from_a_file(small: Path, tmp_path: Path) -> None:
    pose = {"position_m": [1.0, 2.0, 9.0], "quat_xyzw": [0.0, 0.6, 0.0, 0.8]}
    steps = [
        {"sensor": {"pose": pose}, "environment": {"sun_elevation_deg": 5.0}},
        {"modalities": ["depth"]},
    ]
    path = tmp_path / "steps.yaml"
    path.write_text(yaml.safe_dump(steps), encoding="utf-8")
    result = oaisys_here("render", "--config", small, "--out", tmp_path / "out", "--metadata", path)
    assert result.returncode == 0, result.stderr
    batch = tmp_path / "out/batch_0001"
    assert [p.position_m for p in read_poses(batch / "poses.csv")] == [(1.0, 2.0, 9.0)] * 2
    assert [p.name for p in batch.glob("camera/0002*")] == ["0002camera_pinhole_depth_00.exr"]
    path.write_text("- {sensor: {pose: 3}}", encoding="utf-8")
    result = oaisys_here("render", "--config", small, "--out", tmp_path / "no", "--metadata", path)
    assert result.returncode == 2
    assert "metadata.samples.0.sensor.pose" in result.stderr


def test_samples_are_those_of_the_file_alone(small: Path, tmp_path: Path) -> None:
    """`--samples` beside a file was ignored, and an empty list of metadata rendered a view."""
    steps, poses, out = tmp_path / "steps.yaml", tmp_path / "poses.csv", tmp_path / "out"
    steps.write_text("[{}, {}]", encoding="utf-8")
    poses.write_text("x_m,y_m,z_m,qx,qy,qz,qw\n0,0,9,0,0,0,1\n", encoding="utf-8")
    run = ("render", "--config", small, "--out", out)
    for options, expected in (
        (("--metadata", steps, "--samples", "5"), "samples: received 5, expected none with"),
        (("--poses", poses, "--samples", "1"), "samples: received 1, expected none with"),
        (("--metadata", steps, "--poses-camera", "camera"), "expected none without --poses"),
    ):
        refused = oaisys_here(*run, *options)
        assert refused.returncode == 2, refused.stdout
        assert expected in refused.stderr
    for empty in ("[]", "samples: []", "samples:"):
        steps.write_text(empty, encoding="utf-8")
        refused = oaisys_here(*run, "--metadata", steps)
        assert refused.returncode == 2, refused.stdout
        assert "expected a list of at least one sample" in refused.stderr
    assert not out.exists()


def test_a_run_that_renders_nothing_fails(tmp_path: Path) -> None:
    never = SMALL.replace("width_px", "step_offset: 9, width_px")
    path = tmp_path / "never.yaml"
    path.write_text(never, encoding="utf-8")
    for more in ((), ("--resume",)):
        result = oaisys_here("render", "--config", path, "--out", tmp_path / "out", *more)
        assert result.returncode == 1, result.stdout
        assert "nothing was rendered" in result.stderr


def test_saved_worlds_need_blender(small: Path, tmp_path: Path) -> None:
    result = oaisys_here("render", "--config", small, "--out", tmp_path / "out", "--save-blend")
    assert result.returncode == 2
    assert "save_blend" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_config_import_writes_what_config_check_takes(tmp_path: Path) -> None:
    out = tmp_path / "ours.yaml"
    result = oaisys_here("config", "import", write(document(), tmp_path), "--out", out)
    assert result.returncode == 0, result.stderr
    assert "SIMULATION_SETUP.renderImages: no counterpart" in result.stdout
    assert oaisys_here("config", "check", out).returncode == 0


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
    result = oaisys_here("render", "--config", small, "--out", tmp_path / "out", *arguments)
    assert result.returncode == 2
    assert all(part in result.stderr for part in parts), result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


def test_config_check(small: Path) -> None:
    assert oaisys_here("config", "check", small).returncode == 0
    small.write_text("seed: -1", encoding="utf-8")
    assert oaisys_here("config", "check", small).returncode == 2


def test_config_show_prints_a_config_that_is_read_back() -> None:
    shown = yaml.safe_load(oaisys_here("config", "show").stdout)
    assert config_from_mapping(shown) == SimulationConfig()


@pytest.mark.parametrize(
    "path", [REPOSITORY / "config/simulator.yaml", *REPOSITORY.glob("config/examples/*.yaml")]
)
def test_the_examples_are_valid(path: Path) -> None:
    load_config(path)


def test_the_documented_default_is_the_default() -> None:
    assert load_config(REPOSITORY / "config/simulator.yaml") == SimulationConfig()


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (["render", "--position", "nan", "0", "1", "--look-at", "0", "0", "0"], "position"),
        (["render", "--position", "1", "0", "1", "--look-at", "0", "inf", "0"], "look-at"),
        (["dataset", "render", "a.yaml", "--memory-per-worker", "inf"], "memory-per-worker"),
        (["dataset", "render", "a.yaml", "--gpus-per-worker", "inf"], "gpus-per-worker"),
        (["evaluate", "--mesh", "a.ply", "--truth", "b.ply", "--voxel-size", "inf"], "voxel-size"),
    ],
)
def test_numbers_of_options_are_finite(arguments: list[str], field: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = [] if arguments[0] == "evaluate" else ["--out", out]
    result = oaisys_here(*arguments, *options)
    assert result.returncode == 2, result.stderr
    assert f"{field}: received " in result.stderr
    assert "expected a finite number" in result.stderr
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["render", "--out", ""], "--out"),
        (["render", "--out="], "--out"),
        (["render", "--config", ""], "--config"),
        (["render", "--out", "x", "--position", "", "1", "2"], "--position"),
        (["repeat", ""], "RECORD"),
        (["config", "schema", "--out", ""], "--out"),
        (["config", "show", "--config", ""], "--config"),
        (["sensors", "import", "robot.urdf", "--out", ""], "--out"),
        (["sensors", "import", "robot.urdf", "--packages", ""], "--packages"),
        (["drive", "plan", "drive.yaml", "--out", ""], "--out"),
        (["drive", "--out", ""], "--out"),
        (["evaluate", "--mesh", "a.ply", "--truth", "b.ply", "--json", ""], "--json"),
        (["heights", "--out", ""], "--out"),
        (["dataset", "check", ""], "DATASET"),
        (["dataset", "merge", "a", "", "--out", "b"], "DIR"),
        (["record", "--topic", "/a", "--topic", ""], "--topic"),
        (["record", "--out", ""], "--out"),
        (["ros", "reference", "--out", ""], "--out"),
        (["survey", "--params-file", ""], "--params-file"),
        (["explore", "--out", ""], "--out"),
        (["live", "--address", ""], "--address"),
    ],
)
def test_empty_text_is_refused_by_the_name_of_its_option(
    arguments: list[str], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`--out "$OUT"` of an unset variable wrote into the current folder, with exit code 0."""
    monkeypatch.chdir(tmp_path)
    result = oaisys_here(*arguments)
    assert result.returncode == 2, result.stderr
    assert f"oaisys: {name}: received '', expected text that is not empty" in result.stderr
    assert not list(tmp_path.iterdir())
