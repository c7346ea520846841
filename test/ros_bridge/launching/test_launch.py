"""The launch files, where ROS's launch system is installed and this workspace is built.

colcon build --packages-up-to oaisys_ros_bridge && source install/setup.bash
"""

from __future__ import annotations

import json
import runpy
import signal
import uuid
from pathlib import Path
from typing import Any

import pytest
import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from driven_world import DRIVEN_WORLD, DUE, TOPIC_OF_SENSOR
from launched import Launched
from leak_check import MARK, LeakCheck, marked_processes
from mcap.reader import make_reader
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from repository import REPOSITORY
from ros_peer import User, messages_of_samples
from served_simulator import FLAT_WORLD, MOUNDS
from waiting import START_PATIENCE_S, wait_until

from oaisys_core.geometry import pose_looking_down
from oaisys_ros_bridge.launching.arguments import DRIVE, EXPLORE, SIMULATOR, SURVEY

pytest.importorskip(
    "launch_ros", reason="ROS's launch system is not installed", exc_type=ModuleNotFoundError
)
try:
    get_package_prefix("oaisys_ros_bridge")
except PackageNotFoundError:
    BUILD = "colcon build --packages-up-to oaisys_ros_bridge, then source install/setup.bash"
    pytest.skip(f"the workspace is not built: {BUILD}", allow_module_level=True)

LAUNCH_FILES = sorted((REPOSITORY / "launch").glob("*.launch.py"))
ARGUMENTS = {
    "simulator": set(SIMULATOR),
    "drive": set(DRIVE),
    "survey": {*SURVEY, "rviz"},
    "explore": {*EXPLORE, "rviz"},
}

OFF_THE_STAGE = '{"waypoints_m": [[0, 0], [90, 0]]}'


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
    assert "Destroyable" not in launched.log.read_text()
    common = {"/clock", "/diagnostics", "/parameter_events", "/rosout"}
    assert {name for name in names if not name.startswith("/mars/")} <= common
    with next(bag.glob("*.mcap")).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    assert {"/mars/tf", "/mars/tf_static", "/mars/camera/depth/image_raw"} <= topics


@pytest.mark.ros
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_what_a_launch_has_started_ends_with_it(
    tmp_path: Path,
    world: Path,
    ros_domain_id: int,
    number: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(MARK, mark := str(uuid.uuid4()))
    bag = tmp_path / "bag"
    arguments = {"config": world, "backend": "analytic", "address": "127.0.0.1:0"}
    arguments |= {"record": bag, "recorder": "oaisys"}
    with Launched("simulator", tmp_path, **arguments) as launched:
        launched.wait_for("ready: simulator")
        launched.wait_for("recording: ")
        launched.process.send_signal(number)  # to it alone
        launched.process.wait(START_PATIENCE_S)
    # What is left is shared memory of the launch's own node.
    wait_until(lambda: not marked_processes(mark), explain=lambda: marked_processes(mark))
    assert (bag / "metadata.yaml").is_file()
    with next(bag.glob("*.mcap")).open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert "Traceback" not in launched.log.read_text()


@pytest.mark.ros
def test_frames_with_a_prefix_stay_on_the_common_tf(
    tmp_path: Path, world: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    from tf2_msgs.msg import TFMessage

    from oaisys_ros_bridge.qos import LATCHED_HISTORY_QOS

    user = User(namespace="mars")
    user.listen(TFMessage, "/tf_static", LATCHED_HISTORY_QOS)
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
    file = tmp_path / "parameters.yaml"
    file.write_text("oaisys_mapper: {ros__parameters: {settle_timeout: 100.0}}")
    config = tmp_path / "mounds.yaml"
    config.write_text(yaml.safe_dump(MOUNDS))
    arguments = {"config": config, "out": out, "size": "160x120", "views": 2}
    arguments |= {"params_file": file, "log_level": "info", "faults": "false", "namespace": "mars"}
    with Launched("survey", tmp_path, **arguments) as launched:
        assert launched.process.wait(300) == 0, launched.log.read_text()
    assert json.loads((out / "report.json").read_text())["closed"] is True


@pytest.mark.ros
def test_a_survey_that_does_not_close_is_a_launch_that_fails(
    tmp_path: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    out = tmp_path / "out"
    arguments = {"backend": "analytic", "out": out, "size": "24x18", "views": 1}
    with Launched("survey", tmp_path, **arguments, record="false", faults="false") as launched:
        assert launched.process.wait(300) == 1, launched.log.read_text()
    assert "survey has ended: exit code 1" in launched.log.read_text()
    assert json.loads((out / "report.json").read_text())["closed"] is False


@pytest.mark.ros
@pytest.mark.parametrize(
    ("drive_json", "code"), [("", 0), ('{"waypoints_m": [[0, 0], [90, 0]]}', 1)]
)
def test_a_drive_is_launched_recorded_and_ends_the_launch(
    drive_json: str, code: int, tmp_path: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    config, bag = tmp_path / "world.yaml", tmp_path / "bag"
    config.write_text(yaml.safe_dump(DRIVEN_WORLD))
    arguments = {"config": config, "address": "127.0.0.1:0", "record": bag, "namespace": "mars"}
    with Launched("drive", tmp_path, **arguments, drive_json=drive_json) as launched:
        assert launched.process.wait(300) == code, launched.log.read_text()
    log = launched.log.read_text()
    if code:
        assert "a way with all wheels on the stage" in log
        assert "the drive has ended: exit code 1" in log
        return
    assert "Traceback" not in log
    recorded = messages_of_samples(bag)
    topics = {f"/mars/{topic}": DUE[sensor] for sensor, topic in TOPIC_OF_SENSOR.items()}
    assert {topic: recorded[topic] for topic in topics} == topics
    assert recorded["/mars/tf"] == DUE["imu"]


@pytest.mark.ros
def test_parameters_reach_all_nodes_and_the_clock_is_the_bridges(
    tmp_path: Path, world: Path, leaks: LeakCheck, ros_domain_id: int
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**/oaisys_bridge: {ros__parameters: {publish_clock: true, path.length: 7}}\n"
        "/**/oaisys_mapper: {ros__parameters: {voxel_size: 0.25}}\n"
    )
    user = User()
    arguments = {"config": world, "backend": "analytic", "address": "127.0.0.1:0"}
    arguments |= {"params_file": file, "use_sim_time": "true", "log_level": "debug"}
    arguments |= {"record": tmp_path / "bag", "recorder": "oaisys"}
    with Launched("simulator", tmp_path, **arguments) as launched:
        launched.wait_for("ready: simulator")
        launched.wait_for("recording: ")
        found = {
            node: parameters_of(user, node, names)
            for node, names in {
                "oaisys_bridge": ["publish_clock", "path.length", "use_sim_time"],
                "oaisys_mapper": ["voxel_size", "use_sim_time"],
                "oaisys_recorder": ["use_sim_time"],
            }.items()
        }
        user.close()
        assert launched.interrupt() == 0
    log = launched.log.read_text()
    assert found == {
        "oaisys_bridge": [True, 7, False],
        "oaisys_mapper": [0.25, True],
        "oaisys_recorder": [True],
    }
    assert "[DEBUG]" in log
    assert "Destroyable" not in log


def parameters_of(user: User, node: str, names: list[str]) -> list[Any]:
    client = user.client(GetParameters, f"/{node}/get_parameters")
    answer = user.answer(client.call_async(GetParameters.Request(names=names)))
    return [parameter_value_to_python(value) for value in answer.values]
