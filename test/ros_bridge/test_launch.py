"""The launch files, where ROS's launch system is installed."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest
import yaml
from launched import Launched
from leak_check import LeakCheck
from mcap.reader import make_reader
from ros_peer import User
from served_simulator import FLAT_WORLD

from oaisys_core.geometry import pose_looking_down

pytest.importorskip("launch_ros", reason="ROS's launch system is not installed")

REPOSITORY = Path(__file__).resolve().parents[2]
LAUNCH_FILES = sorted((REPOSITORY / "launch").glob("*.launch.py"))
SHARED = {"config", "backend", "namespace", "rviz", "record", "worker_python"}
ARGUMENTS = {
    "simulator": SHARED | {"address", "frame_prefix", "mapper", "recorder"},
    "survey": SHARED | {"out", "views", "seed", "size", "quality"},
    "explore": SHARED | {"out", "views", "seed", "size", "quality", "planner"},
}


@pytest.fixture
def world(tmp_path: Path) -> Path:
    file = tmp_path / "world.yaml"
    file.write_text(yaml.safe_dump(FLAT_WORLD))
    return file


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_a_launch_file_describes_all_of_its_arguments(file: Path) -> None:
    description = runpy.run_path(str(file))["generate_launch_description"]()

    arguments: list[Any] = description.get_launch_arguments()
    assert {argument.name for argument in arguments} == ARGUMENTS[file.name.split(".")[0]]
    assert all(len(argument.description) > 20 for argument in arguments)
    assert all(argument.default_value is not None for argument in arguments)


@pytest.mark.ros
def test_the_simulator_is_launched_into_a_namespace_and_leaves_nothing(
    tmp_path: Path, world: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    bag = tmp_path / "bag"
    user = User(namespace="mars")
    arguments = {"config": world, "backend": "analytic", "address": "127.0.0.1:0"}
    arguments |= {"namespace": "mars", "record": bag, "recorder": "oaisys"}
    with Launched("simulator", tmp_path, **arguments) as launched:
        launched.wait_for("ready: mars")
        launched.wait_for("recording: ")
        user.wait_until_ready()
        user.wait_until_matched(["/mars/camera/depth/image_raw"], subscribers=2)
        answer = user.set_pose(pose_looking_down(0.0, 0.0, 5.0))
        assert answer.success, answer.message
        names = {name for name, _ in user.node.get_topic_names_and_types()}
        user.close()

        assert launched.interrupt() == 0
    assert "Traceback" not in launched.log.read_text()
    common = {"/clock", "/diagnostics", "/parameter_events", "/rosout"}
    assert {name for name in names if not name.startswith("/mars/")} <= common
    with next(bag.glob("*.mcap")).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    assert {"/mars/tf", "/mars/tf_static", "/mars/camera/depth/image_raw"} <= topics


@pytest.mark.ros
def test_frames_with_a_prefix_stay_on_the_common_tf(
    tmp_path: Path, world: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    from tf2_msgs.msg import TFMessage

    from oaisys_ros_bridge.qos import TF_STATIC_QOS

    user = User(namespace="mars")
    user.listen(TFMessage, "/tf_static", TF_STATIC_QOS)
    arguments = {"config": world, "backend": "analytic", "address": "127.0.0.1:0"}
    arguments |= {"namespace": "mars", "frame_prefix": "mars/", "mapper": "false"}
    with Launched("simulator", tmp_path, **arguments) as launched:
        launched.wait_for("ready: mars")
        user.wait_until(lambda: user.received["/tf_static"])
        user.close()
        assert launched.interrupt() == 0
    frames = {
        name
        for message in user.received["/tf_static"]
        for transform in message.transforms
        for name in (transform.header.frame_id, transform.child_frame_id)
    }
    assert frames == {"mars/base_link", "mars/camera_link", "mars/camera_optical_frame"}


@pytest.mark.ros
@pytest.mark.parametrize("name", ["survey", "explore"])
def test_an_experiment_that_is_interrupted_leaves_nothing(
    name: str, tmp_path: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    arguments = {"backend": "analytic", "out": tmp_path / "out", "size": "64x48", "views": 200}
    with Launched(name, tmp_path, **arguments) as launched:
        launched.wait_for("building the world")
        launched.interrupt()
    assert "Traceback" not in launched.log.read_text()


@pytest.mark.ros
def test_a_survey_is_launched_to_its_end(
    tmp_path: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    out = tmp_path / "out"
    arguments = {"backend": "analytic", "out": out, "size": "96x72", "views": 2}
    with Launched("survey", tmp_path, **arguments, namespace="mars") as launched:
        assert launched.process.wait(300) == 0, launched.log.read_text()
    assert json.loads((out / "report.json").read_text())["closed"] is True
