"""What nobody means well, sent to the services and subscriptions that rclpy makes for a node."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from ros_peer import User
from rosgraph_msgs.msg import Clock

from oaisys_ros_bridge.guarded_node import MAX_PARAMETERS, GuardedNode
from oaisys_ros_bridge.parameters.node_parameters import ParameterNode
from oaisys_ros_bridge.parameters.table import ParameterRow, ParameterTable

pytestmark = pytest.mark.ros

STRING, DOUBLE = Parameter.Type.STRING.value, Parameter.Type.DOUBLE.value
OF_NO_TYPE = ParameterMsg(name="rate", value=ParameterValue(type=77))


@pytest.fixture
def node(user: User) -> Iterator[ParameterNode]:
    """A node with one parameter, which raises in the user's executor where it would end."""
    node = ParameterNode("guarded", context=user.node.context)
    node.declare_table(ParameterTable([ParameterRow("rate", 1.0, "Rate.", "Hz")]))
    user.spin_with(node)
    yield node
    node.destroy_node()


def answer(user: User, kind: type[Any], name: str, **fields: Any) -> Any:
    return user.answer(user.client(kind, f"guarded/{name}").call_async(kind.Request(**fields)))


def double(value: float) -> ParameterMsg:
    return ParameterMsg(name="rate", value=ParameterValue(type=DOUBLE, double_value=value))


def test_a_parameter_of_no_type_is_refused_in_the_answer(user: User, node: ParameterNode) -> None:
    refusal = "rate.type: received 77, expected a type of ROS's, 0 to 9"
    both = [OF_NO_TYPE, double(2.0)]

    each = answer(user, SetParameters, "set_parameters", parameters=both).results
    assert [(result.successful, result.reason) for result in each] == [(False, refusal), (True, "")]
    assert node.parameters["rate"] == 2.0

    both = [double(3.0), OF_NO_TYPE]
    together = answer(user, SetParametersAtomically, "set_parameters_atomically", parameters=both)
    assert (together.result.successful, together.result.reason) == (False, refusal)
    assert node.parameters["rate"] == 2.0


def test_a_node_without_a_table_refuses_them_too(user: User) -> None:
    node = GuardedNode("guarded", context=user.node.context)
    user.spin_with(node)
    unknown = ParameterMsg(name="unknown", value=ParameterValue(type=STRING))
    parameters = [OF_NO_TYPE, unknown]
    results = answer(user, SetParameters, "set_parameters", parameters=parameters).results
    assert [result.successful for result in results] == [False, False]
    assert "0 to 9" in results[0].reason
    assert "unknown" in results[1].reason
    node.destroy_node()


@pytest.mark.usefixtures("node")
def test_requests_of_many_parameters_are_refused_in_a_short_answer(user: User) -> None:
    too_many = 10 * MAX_PARAMETERS
    refusal = f"parameters: received {too_many}, expected at most {MAX_PARAMETERS} in a request"
    unknown = [ParameterMsg(name=f"p{number}") for number in range(too_many)]

    each = answer(user, SetParameters, "set_parameters", parameters=unknown)
    assert [result.reason for result in each.results[:2]] == [refusal, "see the first result"]
    assert len(each.results) == too_many
    assert not any(result.successful for result in each.results)
    request = SetParameters.Request(parameters=unknown)
    assert len(serialize_message(each)) < len(serialize_message(request))

    name = "set_parameters_atomically"
    together = answer(user, SetParametersAtomically, name, parameters=unknown)
    assert (together.result.successful, together.result.reason) == (False, refusal)

    names = ["rate"] * too_many
    assert not answer(user, DescribeParameters, "describe_parameters", names=names).descriptors
    assert not answer(user, GetParameters, "get_parameters", names=names).values
    few = names[:MAX_PARAMETERS]
    assert len(answer(user, GetParameters, "get_parameters", names=few).values) == MAX_PARAMETERS


@pytest.mark.parametrize(
    "time", [Time(sec=-1), Time(sec=-(2**31), nanosec=5), Time(sec=2**31 - 1, nanosec=2**32 - 1)]
)
def test_times_that_no_clock_has_are_ignored(
    user: User, capfd: pytest.CaptureFixture[str], time: Time
) -> None:
    simulated = [Parameter("use_sim_time", value=True)]
    node = GuardedNode("guarded", context=user.node.context, parameter_overrides=simulated)
    user.spin_with(node)
    clock = user.node.create_publisher(Clock, "/clock", 10)
    log: list[str] = []

    def has(condition: bool, sent: Time) -> bool:
        log.append(capfd.readouterr().err)
        clock.publish(Clock(clock=sent))
        return condition

    def now() -> Time:
        return node.get_clock().now().to_msg()

    user.wait_until(lambda: has("are ignored" in "".join(log), time))
    user.wait_until(lambda: has(now() == Time(sec=2**31 - 1), Time(sec=2**31 - 1)))
    for _ in range(5):
        clock.publish(Clock(clock=time))
        user.wait_until(lambda: has(now() == Time(sec=5), Time(sec=5)))
    node.destroy_node()
    (told,) = [line for line in "".join(log).splitlines() if "/clock" in line]
    assert f"received '{time.sec} s {time.nanosec} ns', expected a time from 0 s on" in told
