"""The numbered examples, run as a user runs them: from another folder, with a small world."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import runpy
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image
from repository import REPOSITORY
from served_simulator import MOUNDS, Server
from small_datasets import render_dataset

EXAMPLES = REPOSITORY / "examples"
NUMBERED = sorted(path.name for path in EXAMPLES.glob("[0-9]*.py"))
LONGER = {"03_planner.py"}
"""It says of each view that fails why it did; `test_planner_example.py` runs it."""
TIMEOUT_S = 400.0

SMALL_WORLD: dict[str, Any] = {
    "seed": 4,
    "backend": "analytic",
    "stage": {"extent_m": 30, "resolution_px": 301, "surroundings": "plain"},
    "materials": {"texture_size_px": 64, "mask": {"size_px": 128}},
    "assets": {"rocks": [{"count": [60, 60], "size_m": [0.3, 1.0]}]},
    "sensors": {"cameras": [{"width_px": 64, "height_px": 48, "fx_px": 54.114, "fy_px": 54.114}]},
}


@pytest.fixture
def world(tmp_path: Path) -> Path:
    path = tmp_path / "world.yaml"
    path.write_text(yaml.safe_dump(SMALL_WORLD), encoding="utf-8")
    return path


def run(name: str, folder: Path, *arguments: str, **environment: str) -> str:
    """Return what an example prints; it must end with exit code 0."""
    ended = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.mark.parametrize("name", NUMBERED)
def test_an_example_is_short_and_says_how_it_is_run(name: str) -> None:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    docstring = ast.get_docstring(ast.parse(text)) or ""
    assert f"python examples/{name}" in docstring
    assert 15 <= len(text.splitlines()) <= 46 or name in LONGER


def run_here(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    folder: Path,
    *arguments: str,
) -> str:
    """Return what an example prints, run in this process, which has imported its packages."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    ends = pytest.raises(SystemExit, match=r"^0$") if "--help" in arguments else nullcontext()
    with ends:
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out


@pytest.mark.parametrize("name", NUMBERED)
def test_an_example_tells_its_arguments_and_does_nothing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_here(monkeypatch, capsys, name, tmp_path, "--help").startswith(f"usage: {name}")
    assert not list(tmp_path.iterdir())


def test_the_examples_are_numbered_without_a_gap() -> None:
    assert [int(name[:2]) for name in NUMBERED] == list(range(1, len(NUMBERED) + 1))


def test_one_view(world: Path, tmp_path: Path) -> None:
    output = run("01_one_view.py", tmp_path, str(world))
    assert "camera depth: float32 (48, 64)" in output
    assert re.search(r"nearest \d+\.\d\d m, sky \d+% of the image", output)
    assert Image.open(tmp_path / "out" / "one_view.png").size == (64, 48)


@pytest.mark.long
@pytest.mark.usefixtures("no_process_left")
def test_over_grpc(tmp_path: Path) -> None:
    with Server(tmp_path / "server", SMALL_WORLD) as server:
        output = run("02_over_grpc.py", tmp_path, server.address)
    assert "sample 1: median depth" in output
    arrived = re.findall(r"sample 2: (\w+) is here", output)
    assert sorted(arrived) == ["depth", "instance", "rgb", "semantic_0"]
    assert arrived[-1] == "rgb"
    assert "refused: pose.position" in output
    assert (tmp_path / "out" / "over_grpc.png").is_file()


def test_own_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = run_here(monkeypatch, capsys, "04_own_world.py", tmp_path)
    middle_m, given_m = re.findall(r"\[(\S+) .*given: (\S+) m", output)[0]
    assert float(middle_m) == pytest.approx(float(given_m), abs=0.02)
    assert "stereo_left depth" in output
    assert "stereo_right rgb" in output
    assert Image.open(tmp_path / "out" / "own_world.png").width > 4 * 640


def test_labels(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    world = tmp_path / "world.yaml"
    stage = {**SMALL_WORLD["stage"], "surroundings": "land"}
    world.write_text(yaml.safe_dump({**SMALL_WORLD, "stage": stage}), encoding="utf-8")
    output = run_here(monkeypatch, capsys, "05_labels.py", tmp_path, str(world))
    shares = re.findall(r"(\w+): (\S+)%", output)
    assert {name for name, _ in shares} == {"gravel", "sand", "rock"}
    assert sum(float(share) for _, share in shares) == pytest.approx(100, abs=0.3)
    seen, total = map(int, re.findall(r"(\d+) of (\d+) things", output)[0])
    assert 0 < seen <= total
    assert 60 < total < 60 + 1000, "the rocks of the stage, and those on the land around it"
    assert Image.open(tmp_path / "out" / "labels.png").size[0] > 2 * 64


@pytest.mark.long
def test_training_gets_batches_and_trains_where_pytorch_is_there(tmp_path: Path) -> None:
    render_dataset(tmp_path / "set", {0: "train", 1: "val", 2: "train"}, views=2)
    output = run("07_train_on_a_dataset.py", tmp_path, str(tmp_path / "set"), "30")
    assert "4 frames, " in output
    assert "a batch has (4, 3, 72, 96) colours" in output
    losses = [float(loss) for loss in re.findall(r"loss (\S+)", output)]
    if importlib.util.find_spec("torch"):
        assert len(losses) == 30
        assert losses[-1] < losses[0]
    else:
        assert "PyTorch is not installed" in output


@pytest.mark.long
def test_drive_tells_each_stamp_and_what_the_lidar_hit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = run_here(monkeypatch, capsys, "08_drive.py", tmp_path, "--seconds", "0.1")
    stamps = re.findall(r"^(\S+) s: at .* m, (\d+) lidar hits$", output, re.MULTILINE)
    assert [stamp for stamp, _ in stamps] == ["0.0", "0.1"]
    # 64 rings of 512 rays.
    assert all(0 < int(hits) <= 64 * 512 for _, hits in stamps)
    assert "specific_force_m_s2=<float64 (2000, 3)>" in output


@pytest.mark.long
def test_each_next_best_view_shows_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = run_here(monkeypatch, capsys, "09_next_best_view.py", tmp_path, "--views", "2")
    voxels = [int(count) for count in re.findall(r"(\d+) voxels of surface", output)]
    assert len(voxels) == 2
    assert 0 < voxels[0] < voxels[1]


@pytest.mark.long
def test_lunar_sun_is_as_high_as_spherical_astronomy_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = run_here(monkeypatch, capsys, "10_lunar_day.py", tmp_path, "--hours", "8", "12")
    elevations_deg = [float(each) for each in re.findall(r"sun (\S+)° up", output)]
    # At noon 90° less the latitude; at H = 60°, sin h = cos 60° cos 60° = 1/4.
    assert elevations_deg == pytest.approx([14.5, 30.0], abs=0.05)
    strip = np.asarray(Image.open(tmp_path / "out" / "lunar_day.png").convert("L"))
    morning, noon = np.hsplit(strip, 2)
    assert (morning < 8).mean() > 2 * (noon < 8).mean(), "shadows are longer in the morning"


CAMERA_INFO = """
image_width: 64
image_height: 48
camera_name: mast
camera_matrix: {rows: 3, cols: 3, data: [50, 0, 31.5, 0, 51, 23.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [50, 0, 31.5, 0, 0, 51, 23.5, 0, 0, 0, 1, 0]}
"""


@pytest.mark.long
def test_robot_has_its_lidar_and_the_camera_of_the_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = tmp_path / "mast.yaml"
    calibration.write_text(CAMERA_INFO, encoding="utf-8")
    arguments = ("--calibration", str(calibration))
    output = run_here(monkeypatch, capsys, "11_robot.py", tmp_path, *arguments)
    assert re.search(r"mast depth: 64x48, K \[50\. +0\. +31\.5\]", output)
    assert re.search(r"scans: lidar \(\d+,\)", output)
    assert "front" not in output.partition("mast")[2], "the robot's own camera is replaced"


@pytest.mark.long
@pytest.mark.ros
@pytest.mark.usefixtures("no_process_left")
def test_survey(tmp_path: Path, ros_domain_id: int) -> None:
    world = tmp_path / "world.yaml"
    world.write_text(yaml.safe_dump(MOUNDS), encoding="utf-8")
    output = run("06_survey.py", tmp_path, str(world), ROS_DOMAIN_ID=str(ros_domain_id))
    assert "verdict: the map agrees with the world" in output
    folder = tmp_path / "out" / "survey_from_python"
    assert json.loads((folder / "report.json").read_text(encoding="utf-8"))["closed"] is True
    assert (folder / "certificate.json").is_file()


@pytest.mark.long
def test_the_gym(tmp_path: Path) -> None:
    output = run("12_gym.py", tmp_path, "--episodes", "1")
    assert re.findall(r"seed 0, (\w+): reward", output) == ["random", "baseline"]
    assert "the last view: (48, 64, 3)" in output
    assert Image.open(tmp_path / "out" / "gym.png").size == (4 * 64, 2 * 48)
