"""What an experiment knows and imports before its processes run, and from when it counts."""

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from oaisys_core.config import config_from_mapping
from oaisys_core.errors import ConfigError, InvalidInputError
from oaisys_core.world.modules import SensorsModule
from oaisys_ros_bridge.experiments.configuration import read_sensors
from oaisys_ros_bridge.experiments.progress import STARTED_VARIABLE, seconds_since_start

CAMERA = {"name": "front", "modalities": ["depth", "rgb"]}
PAIR = {"name": "eyes", "modalities": ["depth"]}


@pytest.mark.parametrize(
    "sensors",
    [
        {},
        {"cameras": [CAMERA, {"name": "rear"}]},
        {"stereo": [PAIR]},
        {"cameras": [CAMERA], "stereo": [PAIR]},
    ],
)
def test_the_cameras_of_a_configuration_are_those_of_the_simulator(
    sensors: dict, tmp_path: Path
) -> None:
    config = config_from_mapping({"sensors": sensors})
    path = tmp_path / "config.yaml"
    path.write_text(config.model_dump_json(), encoding="utf-8")
    found, expected = read_sensors(path), SensorsModule(config.sensors).sensors
    assert found.names == tuple(sensor.name for sensor in expected)
    assert found.modalities == expected[0].modalities


def test_images_that_the_settings_leave_out_are_not_waited_for(tmp_path: Path) -> None:
    def modalities(**render: Any) -> tuple[str, ...]:
        config = config_from_mapping({"sensors": {"cameras": [CAMERA]}, "render": render})
        path = tmp_path / "config.yaml"
        path.write_text(config.model_dump_json(), encoding="utf-8")
        return read_sensors(path).modalities

    every = modalities()
    assert modalities(quality="geometry") == tuple(m for m in every if m != "rgb")
    assert modalities(passes=["depth", "rgb"]) == ("depth", "rgb")
    with pytest.raises(ConfigError, match=r"received \['rgb'\], expected depth among them"):
        modalities(passes=["rgb"])


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        # These start processes, which must not wait for what the processes do not need.
        ("oaisys_ros_bridge.experiments.survey.survey", "cv2 grpc matplotlib open3d rclpy"),
        # The mapper listens while its fusion's thread imports Open3D.
        ("oaisys_ros_bridge.nodes.mapper", "matplotlib open3d rich scipy.ndimage"),
        ("oaisys_ros_bridge.nodes.bridge", "matplotlib open3d scipy.spatial"),
        ("oaisys_ros_bridge.nodes.recorder", "cv2 matplotlib open3d"),
    ],
)
def test_a_program_starts_without_what_it_uses_later(module: str, unwanted: str) -> None:
    code = f"import sys, {module}; print(*{set(unwanted.split())} & sys.modules.keys())"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == []


def test_seconds_count_from_the_given_start_or_from_that_of_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(STARTED_VARIABLE, str(time.time() - 1000))
    assert 1000 <= seconds_since_start() < 1060
    monkeypatch.setenv(STARTED_VARIABLE, "noon")
    with pytest.raises(InvalidInputError, match=STARTED_VARIABLE):
        seconds_since_start()
    monkeypatch.delenv(STARTED_VARIABLE)
    before_s = time.monotonic()
    first_s = seconds_since_start()
    assert first_s > 0
    assert seconds_since_start() - first_s <= time.monotonic() - before_s + 0.01
