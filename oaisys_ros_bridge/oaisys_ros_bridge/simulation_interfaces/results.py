"""Services that answer with a ``simulation_interfaces/msg/Result``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from simulation_interfaces.msg import Result

from oaisys_core.errors import NotReadyError, OaisysError


class RefusedError(OaisysError):
    """A request is refused with this result code."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def offer_service(node: Node, kind: Any, name: str, work: Callable[[Any, Any], None]) -> None:
    """Offer a service ``~/name``, in a callback group of its own.

    Args:
        node: Its owner.
        kind: Its type.
        name: Without the node's name.
        work: Fills the response to a request in; raises `OaisysError` to refuse it.
    """

    def answer(request: Any, response: Any) -> Any:
        response.result.result = Result.RESULT_OK
        try:
            work(request, response)
        except OaisysError as error:
            response.result = _result_of(error)
        return response

    group = MutuallyExclusiveCallbackGroup()
    node.create_service(kind, f"~/{name}", answer, callback_group=group)


def _result_of(error: OaisysError) -> Result:
    code = Result.RESULT_OPERATION_FAILED
    if isinstance(error, RefusedError):
        code = error.code
    elif isinstance(error, NotReadyError):
        code = Result.RESULT_INCORRECT_STATE
    return Result(result=code, error_message=str(error))
