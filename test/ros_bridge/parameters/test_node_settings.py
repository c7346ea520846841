"""What is asked of all nodes reaches them, in the order that counts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters
from ros_peer import Stage

from oaisys_core.errors import InvalidInputError
from oaisys_ros_bridge.parameters.node_settings import node_settings

FILE = """
/**/oaisys_mapper:
  ros__parameters: {mesh_period: 7.0, mesh_triangles: 1234}
oaisys_bridge:
  ros__parameters: {publish_clock: true}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "parameters.yaml"
    path.write_text(FILE)
    return path


@pytest.mark.ros
def test_a_file_sets_what_is_usual_and_not_what_is_fixed(stage: Stage, file: Path) -> None:
    settings = node_settings(str(file), "error", use_sim_time=True)
    usual, fixed = {"mesh_period": 0.0, "use_color": False}, {"voxel_size": 0.25}
    arguments = [*settings.ros_arguments("mapper", usual, fixed), "-r", "__ns:=/mars"]
    stage.start_node("mapper", *arguments)
    client = stage.user.client(GetParameters, "/mars/oaisys_mapper/get_parameters")
    names = ["mesh_period", "use_color", "voxel_size", "mesh_triangles", "use_sim_time"]
    values: Any = stage.user.answer(client.call_async(GetParameters.Request(names=names))).values

    assert (values[0].double_value, values[1].bool_value) == (7.0, False)
    assert (values[2].double_value, values[3].integer_value) == (0.25, 1234)
    assert values[4].bool_value


def test_a_file_that_says_otherwise_than_the_experiment_is_refused(file: Path) -> None:
    settings = node_settings(str(file), "", use_sim_time=False)
    with pytest.raises(InvalidInputError, match="without mesh_period of oaisys_mapper"):
        settings.ros_arguments("mapper", {}, {"mesh_period": 1.0})
    assert settings.ros_arguments("bridge", {}, {"mesh_period": 1.0})


def test_who_tells_the_time_is_not_made_to_follow_it(file: Path) -> None:
    settings = node_settings(str(file), "", use_sim_time=True)

    assert settings.follows_clock("mapper")
    assert not settings.follows_clock("bridge")
    file.write_text("/mars/oaisys_bridge: {ros__parameters: {publish_clock: false}}")
    assert node_settings(str(file), "", use_sim_time=True).follows_clock("bridge")


@pytest.mark.parametrize(
    ("text", "level"),
    [("", "loud"), ("a: b", ""), ("- a", ""), ("{", ""), ("a: {b: {c: 1}}", "")],
)
def test_wrong_settings_are_refused(text: str, level: str, file: Path) -> None:
    file.write_text(text)
    with pytest.raises(InvalidInputError, match="log_level" if level else "params_file"):
        node_settings("" if level else str(file), level, use_sim_time=False)


def test_a_file_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"nowhere\.yaml"):
        node_settings(str(tmp_path / "nowhere.yaml"), "", use_sim_time=False)
