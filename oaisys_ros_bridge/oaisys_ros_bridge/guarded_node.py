"""A node that no message to rclpy's own services and subscriptions ends.

rclpy (7.1) makes them by the node's public methods, and an error in their callbacks ends the node.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from oaisys_core.errors import InvalidInputError, quote
from oaisys_ros_bridge.conversions import NS_PER_S

CLOCK_TOPIC = "/clock"

MAX_PARAMETERS = 1000
"""Parameters, names or prefixes in one request: answers have 1 kB for each."""

LISTS = {
    DescribeParameters: "names",
    GetParameters: "names",
    GetParameterTypes: "names",
    ListParameters: "prefixes",
    SetParameters: "parameters",
    SetParametersAtomically: "parameters",
}
"""The fields of the requests to the services of parameters that have no bound."""

PARAMETER_TYPE_IDS = frozenset(each.value for each in Parameter.Type)


class GuardedNode(Node):
    """Refuses parameters and times that no node can have, where rclpy's callbacks raise.

    Parameters are refused in the answer; times on ``/clock`` are ignored, and the first is logged.
    """

    def create_service(self, kind: Any, name: str, callback: Any, **options: Any) -> Any:
        """Offer a service; those of parameters, which rclpy offers here, are guarded."""
        answers: dict[Any, Callable[[Any, Any], Any]] = {
            SetParameters: self._answer_each,
            SetParametersAtomically: self._answer_together,
        }
        if kind in LISTS:
            callback = partial(self._answer_short, kind, answers.get(kind, callback))
        return super().create_service(kind, name, callback, **options)

    def create_subscription(
        self, kind: Any, topic: str, callback: Any, *arguments: Any, **options: Any
    ) -> Any:
        """Subscribe to a topic; that of rclpy's clock is guarded."""
        if kind is Clock and topic == CLOCK_TOPIC and not options.get("raw"):
            callback = partial(self._take_time, callback)
        return super().create_subscription(kind, topic, callback, *arguments, **options)

    def _answer_short(
        self, kind: Any, answer: Callable[[Any, Any], Any], request: Any, response: Any
    ) -> Any:
        """Answer a request about parameters, or refuse it for the length of its list."""
        count = len(getattr(request, LISTS[kind]))
        if count <= MAX_PARAMETERS:
            return answer(request, response)
        expected = f"at most {MAX_PARAMETERS} in a request"
        reason = str(InvalidInputError(LISTS[kind], count, expected))
        self.get_logger().warning(f"{kind.__name__}: {reason}", throttle_duration_sec=10.0)
        if kind is SetParameters:
            # One for each, as its callers count on.
            others = [SetParametersResult(reason="see the first result")] * (count - 1)
            response.results = [SetParametersResult(reason=reason), *others]
        elif kind is SetParametersAtomically:
            response.result = SetParametersResult(reason=reason)
        return response

    def _answer_each(self, request: Any, response: Any) -> Any:
        response.results = [self._set_parameters([each]) for each in request.parameters]
        return response

    def _answer_together(self, request: Any, response: Any) -> Any:
        response.result = self._set_parameters(request.parameters)
        return response

    def _set_parameters(self, messages: Sequence[ParameterMsg]) -> SetParametersResult:
        """Set all parameters, or none and say why."""
        try:
            return self.set_parameters_atomically([parameter_of(each) for each in messages])
        except InvalidInputError as error:
            reason = error
        except ParameterNotDeclaredException:
            names = [each.name for each in messages]
            reason = InvalidInputError("parameters", names, "names that the node has")
        return SetParametersResult(reason=str(reason))

    def _take_time(self, take: Callable[[Clock], object], message: Clock) -> None:
        """Take a time in that a clock can have, which is no time before 1970."""
        time = message.clock
        if time.sec >= 0 and time.nanosec < NS_PER_S:
            take(message)
            return
        received = quote(f"{time.sec} s {time.nanosec} ns")
        self.get_logger().warning(
            f"{CLOCK_TOPIC}: received {received}, expected a time from 0 s on with less than 1e9 "
            "ns: such times are ignored",
            once=True,
        )


def parameter_of(message: ParameterMsg) -> Parameter:
    """Return a message's parameter.

    Raises:
        InvalidInputError: Its type is none of ROS's.
    """
    if message.value.type not in PARAMETER_TYPE_IDS:
        expected = f"a type of ROS's, {min(PARAMETER_TYPE_IDS)} to {max(PARAMETER_TYPE_IDS)}"
        raise InvalidInputError(f"{message.name}.type", message.value.type, expected)
    return Parameter.from_parameter_msg(message)
