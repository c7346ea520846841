"""``oaisys survey`` as a user runs it: real server, bridge, mapper and recorder."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import pytest
import yaml
from commands import oaisys_here
from ros_peer import LATCHED_TYPES, SAMPLE_TYPES, messages_of_samples
from rosbags.highlevel import AnyReader
from served_simulator import MOUNDS
from waiting import wait_until

from tools import second_mapper

pytestmark = pytest.mark.ros

VIEWS = 2
PROMISED = {
    "views",
    "voxel_size_m",
    "rmse_m",
    "accuracy_mean_m",
    "completion_ratio",
    "f_score",
    "hole_ratio",
    "seconds_total",
    "seconds_to_first_picture",
    "seconds_to_report",
    "seconds_per_view",
    "seed",
    "config_sha256",
    "blender_version",
    "backend",
    "quality",
    "closed",
}


def written_world(folder: Path, **changes: Any) -> Path:
    path = folder / "world.yaml"
    path.write_text(yaml.safe_dump({**MOUNDS, **changes}), encoding="utf-8")
    return path


@pytest.fixture
def world(tmp_path: Path) -> Path:
    return written_world(tmp_path)


def command(world: Path, out: Path, *more: str, name: str = "survey") -> list[str]:
    return [
        *(sys.executable, "-m", "oaisys_core", *name.split()),
        *("--config", str(world), "--out", str(out), *more),
    ]


def environment(domain_id: int) -> dict[str, str]:
    return {**os.environ, "ROS_DOMAIN_ID": str(domain_id)}


def survey(world: Path, out: Path, domain_id: int, *more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(world, out, *more),
        env=environment(domain_id),
        capture_output=True,
        text=True,
        timeout=400,
        check=False,
    )


@pytest.fixture(scope="module")
def surveyed(
    tmp_path_factory: pytest.TempPathFactory, ros_of_module: None
) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """The folder of a survey that closes, and how its command ended."""
    folder = tmp_path_factory.mktemp("survey")
    world, out = written_world(folder), folder / "out"
    options = ("--seed", "1", "--views", f"{VIEWS}", "--size", "160x120")
    return out, survey(world, out, int(os.environ["ROS_DOMAIN_ID"]), *options)


def test_a_small_survey_closes(surveyed: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    out, result = surveyed
    assert result.returncode == 0, result.stderr
    assert "the map agrees with the true surface" in result.stderr
    figures = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert figures["closed"] is True
    assert set(figures) >= PROMISED
    assert (figures["views"], figures["seed"], figures["backend"]) == (VIEWS, 1, "analytic")
    assert figures["rmse_m"] < 0.05
    assert figures["completion_ratio"] > 0.95
    assert figures["f_score"] > 0.95
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "The map agrees with the true surface" in page
    _check_first_picture(out, figures, result.stderr)
    _check_bag(out / "bag", VIEWS)
    _check_figures(figures)


@pytest.mark.long
def test_what_a_survey_leaves_behind_says_the_same_to_others(
    surveyed: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    out = tmp_path / "copy"
    shutil.copytree(surveyed[0], out)
    _check_second_mapper(out)
    arguments = ["--mesh", out / "mesh.ply", "--truth", out / "truth.ply"]
    arguments += ["--poses", out / "poses.json", "--max-rmse", "0.05", "--min-completion", "0.95"]
    again = oaisys_here("evaluate", *arguments)
    assert again.returncode == 0, again.stdout + again.stderr
    figures = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert json.loads(again.stdout)["rmse_m"] == pytest.approx(figures["rmse_m"], rel=0.1)
    _check_certificate(out)


def _check_first_picture(out: Path, figures: dict[str, Any], printed: str) -> None:
    """It was written and told before the second view, and timed like the report."""
    path = out / "first_picture.png"
    image = cv2.imread(str(path))
    assert image.shape == (120, 160, 3)
    assert image.std() > 1
    told = f"first picture after {figures['seconds_to_first_picture']:.1f} s: {path}\n"
    assert told in printed
    assert printed.index(told) < printed.index(f"views 2/{VIEWS}")
    assert 0 < figures["seconds_to_first_picture"] < figures["seconds_to_report"]
    last = printed.splitlines()[-1]
    assert re.search(r"first picture after \d+ s, report after \d+ s$", last)


def _check_second_mapper(out: Path) -> None:
    """A mapper that reads the bag alone, and Open3D's own, make the same surface."""
    said = StringIO()
    with redirect_stdout(said):
        code = second_mapper.main([str(out / "bag"), "--mesh", str(out / "mesh.ply")])
    assert code == 0, said.getvalue()
    found = json.loads(said.getvalue())
    assert found["views"] == VIEWS
    assert max(found["chamfer_m"].values()) < 0.02


def _check_figures(figures: dict[str, Any]) -> None:
    assert figures["overlap_hole_count"] == 0
    assert figures["offset_m"] < 0.002
    assert figures["tsdf_rmse_m"] < 0.02
    assert figures["completion_ratio_all"] < figures["visible_share"] + 0.05 < 0.5
    assert {name: figures["iou"][name] > 0.9 for name in ("gravel", "sand")} == {
        "gravel": True,
        "sand": True,
    }
    assert {one["name"]: one["rejected"] for one in figures["faults"]} == {
        "none": False,
        "focal_length": True,
        "pose_beside": True,
        "pose_above": True,
        "pose_scattered": True,
        "range_as_depth": True,
    }


def _check_certificate(out: Path) -> None:
    """It holds, also where everything is rendered again; and the bag alone gives its faults."""
    file = str(out / "certificate.json")
    result = oaisys_here("certificate", "check", file, "--render-again")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "FAILED" not in result.stdout
    assert "the certificate holds" in result.stdout
    result = oaisys_here("certificate", "challenge", str(out))
    assert result.returncode == 0, result.stdout + result.stderr
    with (out / "mesh.ply").open("r+b") as mesh:
        mesh.seek(5000)
        mesh.write(bytes(12))
    result = oaisys_here("certificate", "check", file)
    assert result.returncode == 1
    assert "FAILED: the hash of mesh" in result.stdout


@pytest.mark.parametrize("arguments", [["nowhere.json"], ["--mesh", "nowhere.ply"]])
def test_a_certificate_that_is_none_is_exit_2(world: Path, arguments: list[str]) -> None:
    result = oaisys_here("certificate", "check", str(world), *arguments)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr


def _check_bag(bag: Path, views: int) -> None:
    with AnyReader([bag]) as reader:
        found = {topic: (t.msgtype, t.msgcount) for topic, t in reader.topics.items()}
    counts = messages_of_samples(bag)
    for topic, kind in SAMPLE_TYPES.items():
        assert (found[topic][0], counts[topic]) == (kind, views), topic
    for topic, kind in LATCHED_TYPES.items():
        assert found[topic][0] == kind
        assert found[topic][1] >= 1


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--size", "wide"), ("size", "wide", "WIDTHxHEIGHT")),
        (("--backend", "unreal"), ("backend", "unreal")),
        (("--config", "nowhere.yaml"), ("nowhere.yaml",)),
        (("--views", "0"), ("views",)),
    ],
)
def test_wrong_input_is_exit_2_at_once(
    world: Path, tmp_path: Path, ros_domain_id: int, options: tuple[str, ...], parts: tuple[str]
) -> None:
    result = oaisys_here("survey", "--config", world, "--out", tmp_path / "out", *options)
    assert result.returncode == 2
    assert all(part in result.stderr for part in parts), result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.soak
@pytest.mark.usefixtures("no_process_left")
def test_a_grid_larger_than_the_stage_is_exit_2(
    world: Path, tmp_path: Path, ros_domain_id: int
) -> None:
    options = ("--altitude", "40", "--no-bag", "--size", "64x48")
    result = survey(world, tmp_path / "out", ros_domain_id, *options)
    assert result.returncode == 2, result.stderr
    assert "32 m x 32 m" in result.stderr


@pytest.mark.long
@pytest.mark.usefixtures("no_process_left")
def test_a_signal_ends_everything(world: Path, tmp_path: Path, ros_domain_id: int) -> None:
    options = ("--views", "30", "--altitude", "3", "--size", "64x48", "--no-bag")
    others = set(Path("/dev/shm").glob("fastrtps_*"))
    with subprocess.Popen(
        command(world, tmp_path / "out", *options),
        env=environment(ros_domain_id),
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stderr is not None
        seen = _read_until(process.stderr.readline, "views 2/30")
        # A killed process of earlier may have left the segment of a port, which this one uses.
        own = (each for each in _own_segments(process.pid) if each not in others)
        segments = {each.stat().st_ino for each in own}
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        code = process.wait(60)
    assert code == 128 + signal.SIGINT
    assert "Traceback" not in seen + rest
    assert segments
    # By inode: a node of another domain may have taken a port, and its name, since.
    assert not segments & {each.inode() for each in os.scandir("/dev/shm")}


@pytest.mark.usefixtures("no_process_left")
@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.soak)]
)
def test_a_certificate_that_is_not_issued_leaves_no_folder(
    number: signal.Signals, world: Path, tmp_path: Path, ros_domain_id: int
) -> None:
    """Its command was killed at once, although a survey has processes and folders to end."""
    folder = tmp_path / "t"
    folder.mkdir()
    options = ("--no-bag",)
    with subprocess.Popen(
        command(world, tmp_path / "out", *options, name="certificate issue"),
        env={**environment(ros_domain_id), "TMPDIR": str(folder)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stderr is not None
        seen = _read_until(process.stderr.readline, "starting the simulator")
        wait_until(lambda: list(folder.glob("oaisys-worker-*")), explain=lambda: seen)
        process.send_signal(number)
        rest = process.stderr.read()
        code = process.wait(60)
    assert code == 128 + number
    assert "Traceback" not in rest
    assert not list(folder.iterdir())


def _own_segments(pid: int) -> list[Path]:
    """Return the segments of shared memory that a process holds locked: those that it has made."""
    inode_of = {f"{each.stat().st_ino}": each for each in Path("/dev/shm").glob("fastrtps_*_el")}
    locks = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    held = [each[5].split(":")[-1] for each in locks if each[1] != "->" and each[4] == str(pid)]
    locked = [inode_of[inode] for inode in held if inode in inode_of]
    return [each for lock in locked for each in (lock, Path(str(lock).removesuffix("_el")))]


def _read_until(readline: Callable[[], str], wanted: str) -> str:
    seen = ""
    while wanted not in seen:
        line = readline()
        assert line, f"ended before {wanted!r}:\n{seen}"
        seen += line
    return seen


@pytest.mark.long
@pytest.mark.blender
@pytest.mark.usefixtures("no_process_left")
def test_a_survey_with_blender(tmp_path: Path, ros_domain_id: int) -> None:
    world, out = written_world(tmp_path, backend="blender"), tmp_path / "out"
    options = ("--seed", "1", "--views", "2", "--size", "160x120", "--quality", "preview")
    result = survey(world, out, ros_domain_id, *options, "--no-faults")
    assert result.returncode == 0, result.stderr
    figures = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert figures["backend"] == "blender"
    assert figures["blender_version"].startswith(("4.5.", "5.2."))
    _check_bag(out / "bag", views=2)


@pytest.mark.long
@pytest.mark.usefixtures("no_process_left")
def test_a_world_that_cannot_be_built_names_cause_and_log(
    world: Path, tmp_path: Path, ros_domain_id: int
) -> None:
    out = tmp_path / "out"
    options = ("--views", "1", "--size", "64x48", "--no-bag")
    result = subprocess.run(
        command(world, out, *options),
        env={**environment(ros_domain_id), "OAISYS_TEST_BUILD": "1", "OAISYS_FAULT": "batch-crash"},
        capture_output=True,
        text=True,
        timeout=400,
        check=False,
    )
    assert result.returncode == 1
    assert "the first batch could not be built, twice: " in result.stderr
    assert "the worker was ended by SIGABRT" in result.stderr
    for name in ("server", "bridge"):
        assert f"log: {out / 'logs' / name}.log" in result.stderr
    assert "Traceback" not in result.stderr
