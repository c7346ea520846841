"""Two simulators in one ROS domain, apart by their namespaces alone, survey at the same time."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from leak_check import LeakCheck
from ros_peer import messages_of_samples
from rosbags.rosbag2 import Reader
from served_simulator import MOUNDS

VIEWS = 2
COMMON = {"/clock", "/diagnostics", "/parameter_events", "/rosout"}


def evaluation(folder: Path, truth: Path) -> dict[str, Any]:
    command = ["oaisys", "evaluate", "--mesh", str(folder / "mesh.ply"), "--truth", str(truth)]
    told = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert told.stdout, told.stderr
    return json.loads(told.stdout)


@pytest.mark.soak
@pytest.mark.ros
def test_two_surveys_at_once_map_each_its_own_world(
    tmp_path: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    config = tmp_path / "world.yaml"
    config.write_text(yaml.safe_dump(MOUNDS))
    seeds = {"mars": 1, "moon": 2}
    running = {}
    for name, seed in seeds.items():
        command = ["oaisys", "survey", "--config", str(config), "--out", str(tmp_path / name)]
        command += ["--seed", str(seed), "--namespace", name, "--views", str(VIEWS)]
        command += ["--size", "160x120", "--no-faults"]
        log = (tmp_path / f"{name}.log").open("w")
        running[name] = subprocess.Popen(
            command, stdout=log, stderr=log, start_new_session=True, cwd=tmp_path
        )
    for name, process in running.items():
        assert process.wait(300) == 0, (tmp_path / f"{name}.log").read_text()

    for name, other in (("mars", "moon"), ("moon", "mars")):
        report = json.loads((tmp_path / name / "report.json").read_text())
        assert report["closed"] is True
        assert report["views"] == VIEWS
        assert report["seed"] == seeds[name]
        with Reader(tmp_path / name / "bag") as bag:
            elsewhere = {topic for topic in bag.topics if not topic.startswith(f"/{name}/")}
            assert elsewhere <= COMMON
            assert bag.topics[f"/{name}/camera/depth/image_raw"].msgcount == VIEWS
            assert messages_of_samples(tmp_path / name / "bag")[f"/{name}/tf"] == VIEWS
        wrong = evaluation(tmp_path / name, tmp_path / other / "truth.ply")
        assert wrong["rmse_m"] > 10 * report["rmse_m"]
