"""An error that outlives its call does not keep the call: gRPC would count it as open."""

from __future__ import annotations

import gc
import weakref
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NoReturn

import grpc
from waiting import PATIENCE_S

from oaisys_core.errors import NotReadyError, OaisysError
from oaisys_grpc.contract.errors import abort

CALLS = 20
METHOD = "/test.Service/Refuse"


class Local:
    """What a call's own frame holds."""


def test_calls_are_over_although_their_error_is_kept() -> None:
    kept = [NotReadyError(f"call {number}") for number in range(CALLS)]
    waiting = iter(kept)
    locals_of_calls: list[weakref.ref[Local]] = []

    def refuse(_request: bytes, context: grpc.ServicerContext) -> NoReturn:
        local = Local()
        locals_of_calls.append(weakref.ref(local))
        try:
            raise next(waiting)
        except OaisysError as error:
            abort(context, error)

    class Handler(grpc.GenericRpcHandler):
        def service(self, _details: Any) -> Any:
            return grpc.unary_unary_rpc_method_handler(refuse)

    server = grpc.server(ThreadPoolExecutor(1), handlers=[Handler()])
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    gc.disable()
    try:
        with grpc.insecure_channel(f"127.0.0.1:{port}") as channel:
            call: Any = channel.unary_unary(METHOD)
            for error in kept:
                refused = call.future(b"", timeout=PATIENCE_S).exception()
                assert refused is not None
                assert str(error) in refused.details()
        server.stop(None).wait(PATIENCE_S)
        assert [ref for ref in locals_of_calls[:-1] if ref() is not None] == []
    finally:
        gc.enable()
        server.stop(None)
    assert len(locals_of_calls) == CALLS
