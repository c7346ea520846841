"""Services that answer with a ``simulation_interfaces/msg/Result``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from simulation_interfaces.msg import Result

from oaisys_core.errors import NotReadyError, OaisysError
from oaisys_ros_bridge.services import NodeServices


class RefusedError(OaisysError):
    """A request is refused with this result code."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def offer_services(services: NodeServices, works: Mapping[Any, Callable[[Any, Any], None]]) -> None:
    """Offer services, each with a queue of its own; ``GetEntities`` is ``~/get_entities``.

    Args:
        services: Of the node.
        works: By type of the service: fills the response to a request in; raises `OaisysError` to
            refuse it.
    """
    for kind, work in works.items():
        name = re.sub("(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
        services.offer(kind, f"~/{name}", _answering(work), _refuse)


def _refuse(response: Any, reason: str) -> None:
    response.result = Result(result=Result.RESULT_OPERATION_FAILED, error_message=reason)


def _answering(work: Callable[[Any, Any], None]) -> Callable[[Any, Any], Any]:
    def answer(request: Any, response: Any) -> Any:
        response.result.result = Result.RESULT_OK
        try:
            work(request, response)
        except OaisysError as error:
            response.result = _result_of(error)
        return response

    return answer


def _result_of(error: OaisysError) -> Result:
    code = Result.RESULT_OPERATION_FAILED
    if isinstance(error, RefusedError):
        code = error.code
    elif isinstance(error, NotReadyError):
        code = Result.RESULT_INCORRECT_STATE
    return Result(result=code, error_message=str(error))
