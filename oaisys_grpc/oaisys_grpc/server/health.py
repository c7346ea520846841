"""Health as gRPC has it, which also says why it is not well, and when that may change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import grpc
from grpc_health.v1 import health, health_pb2

from oaisys_core.errors import OaisysError
from oaisys_grpc.contract.errors import printable

REASON_KEY = "oaisys-reason"
"""Of the trailing metadata of ``Check`` where no worker runs."""


class TellingHealth(health.HealthServicer):
    """Answers ``Check`` with the reason in its trailing metadata; ``Watch`` blocks its thread.

    Attributes:
        why_not: Returns why nothing is served; None where something is.
    """

    def __init__(self) -> None:
        # A reader that takes nothing must not hold up the thread that tells of a change.
        super().__init__(experimental_non_blocking=False)
        self.why_not: Callable[[], OaisysError | None] = lambda: None

    def Check(  # noqa: N802 - the contract names it
        self, request: health_pb2.HealthCheckRequest, context: grpc.ServicerContext
    ) -> Any:
        """Answer at once."""
        reason = self.why_not()
        if reason is not None:
            context.set_trailing_metadata(((REASON_KEY, printable(str(reason))),))
        return super().Check(request, context)
