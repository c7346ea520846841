"""The bridge's parameters, each row of their table, and how others set them."""

from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import pytest
import rclpy
from rcl_interfaces.msg import Parameter, ParameterDescriptor
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter as RclpyParameter
from ros_peer import Stage, User
from served_simulator import FLAT_WORLD
from waiting import PATIENCE_S

from oaisys_ros_bridge.parameters.bridge import BRIDGE
from oaisys_ros_bridge.parameters.mapper import MAPPER
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.parameters.table import Changeable, ParameterRow

pytestmark = pytest.mark.ros

ROWS = list(BRIDGE)
RCL_TYPES = {bool: 1, int: 2, float: 3, str: 4, list: 9}
OTHERS: dict[type, Any] = {bool: 1.5, int: "one", float: "one", str: 7, list: "one"}


def wrong_values(row: ParameterRow) -> list[Any]:
    """Values that a row cannot have: of another type, and just out of its range."""
    wrong = [OTHERS[row.kind]]
    if row.kind is float:
        wrong += [math.nan, math.inf]
    if row.kind in (int, float):
        wrong += [] if row.least is None else [row.kind(row.least - 1)]
        wrong += [] if row.most is None else [row.kind(row.most + 1)]
    if row.choices:
        wrong.append("none of them")
    return [value for value in wrong if type(value) is not int or abs(value) < 2**63]


def another_value(row: ParameterRow) -> Any:
    """A value of the row other than its default."""
    if row.kind is bool:
        return not row.default
    if row.choices:
        return next(choice for choice in row.choices if choice != row.default)
    if row.kind is str:
        return {"address": "127.0.0.1:1"}.get(row.name, "another")
    default: Any = row.default
    values = [row.most, row.least, default + 1]
    return row.kind(next(v for v in values if v is not None and v != row.default))


def set_parameter(user: User, name: str, value: Any) -> tuple[bool, str]:
    parameter: Parameter = RclpyParameter(name, value=value).to_parameter_msg()
    request = SetParameters.Request(parameters=[parameter])
    result = user.call(SetParameters, "set_parameters", request).results[0]
    return result.successful, result.reason


def values_of(user: User, names: list[str]) -> dict[str, Any]:
    answer = user.call(GetParameters, "get_parameters", GetParameters.Request(names=names))
    parameters = [Parameter(name=n, value=v) for n, v in zip(names, answer.values, strict=True)]
    return {p.name: RclpyParameter.from_parameter_msg(p).value for p in parameters}


def test_every_row_is_declared_described_and_held_to(stage: Stage) -> None:
    user = stage.user
    stage.start_node("bridge", "--ros-args", "-p", "autostart:=false")
    names = [row.name for row in ROWS]
    listed = user.call(ListParameters, "list_parameters", ListParameters.Request())
    assert set(listed.result.names) >= set(names)
    described = user.call(
        DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names)
    ).descriptors
    for row, descriptor in zip(ROWS, described, strict=True):
        check_descriptor(row, descriptor)
    assert values_of(user, names) == {r.name: r.default for r in ROWS} | {"autostart": False}

    for row in ROWS:
        for wrong in wrong_values(row):
            successful, reason = set_parameter(user, row.name, wrong)
            assert not successful, (row.name, wrong)
            assert reason.startswith(f"{row.name}: received {wrong!r}, expected "), reason
        successful, reason = set_parameter(user, row.name, another_value(row))
        if row.changeable is Changeable.AT_START:
            assert not successful
            assert "when the node starts" in reason
        elif not successful:  # it does not go together with the others' values
            assert reason.startswith(f"{row.name}: received"), reason
        else:
            assert values_of(user, [row.name])[row.name] == another_value(row)
            assert set_parameter(user, row.name, row.default) == (True, "")
    successful, reason = set_parameter(user, "adress", "127.0.0.1:1")
    assert not successful
    assert "adress" in reason
    assert "address" in reason


def check_descriptor(row: ParameterRow, descriptor: ParameterDescriptor) -> None:
    assert descriptor.type == RCL_TYPES[row.kind]
    assert descriptor.description == row.description
    assert row.expectation in descriptor.additional_constraints
    assert descriptor.read_only == (row.changeable is Changeable.AT_START)
    if row.least is not None and row.most is not None:
        ranges = [*descriptor.integer_range, *descriptor.floating_point_range]
        assert [(r.from_value, r.to_value) for r in ranges] == [(row.least, row.most)]


@pytest.mark.long
def test_what_is_read_at_configuration_is_refused_while_configured(stage: Stage) -> None:
    user = stage.user
    server = stage.start_world(FLAT_WORLD)
    nowhere = "127.0.0.1:1"
    stage.start_bridge(nowhere)
    # A bridge that looks in the wrong place is told the right one; whole numbers are doubles.
    assert set_parameter(user, "timeout_s", 60) == (True, "")
    assert set_parameter(user, "address", server.address) == (True, "")
    user.wait_until_ready()

    successful, reason = set_parameter(user, "address", nowhere)

    assert not successful
    assert "while the bridge is active" in reason
    assert values_of(user, ["address", "timeout_s"]) == {
        "address": server.address,
        "timeout_s": 60.0,
    }
    assert set_parameter(user, "publish_points", False) == (True, "")


def test_a_node_does_not_start_with_a_wrong_value(ros_domain_id: int) -> None:
    command = [sys.executable, "-m", "oaisys_ros_bridge.nodes.bridge", "--ros-args"]
    command += ["-p", "timeout_s:=-1.0"]

    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)

    assert ended.returncode == 2
    assert ended.stderr.strip() == "timeout_s: received -1.0, expected double from 0.1 to 86400 s"


@pytest.mark.usefixtures("ros_domain_id")
def test_parameters_that_a_node_does_not_have_are_named(capfd: pytest.CaptureFixture[str]) -> None:
    """A misspelt parameter was dropped without a word, and its default counted."""
    given = ["voxelsize:=0.3", "voxel_size:=0.4", "use_sim_time:=false", "qos_overrides./x.y:=1"]
    rclpy.init(args=["node", "--ros-args", *(part for each in given for part in ("-p", each))])
    try:
        node = ParameterNode("node")
        assert node.declare_table(MAPPER)["voxel_size"] == 0.4
        node.destroy_node()
    finally:
        rclpy.shutdown()
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "parameter" in line]
    assert line.endswith("parameter 'voxelsize' is unknown here (did you mean voxel_size?)")
