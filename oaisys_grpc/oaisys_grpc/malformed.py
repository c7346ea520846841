"""Bytes that are no message end with INVALID_ARGUMENT, and leave no traceback in the log."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from oaisys_core.errors import InvalidInputError
from oaisys_grpc.errors import abort

OWN_SERVICES = "/oaisys."
"""How the paths of our calls begin; gRPC's own services look after themselves."""

Handler = Any
"""A ``grpc.RpcMethodHandler``, or None for a call that nobody serves."""


class MalformedRequests(grpc.ServerInterceptor):
    """Refuses what gRPC would call an internal error of the server."""

    def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Handler],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Handler:
        """Return the call's handler, reading its requests with care."""
        handler = continuation(handler_call_details)
        ours = handler_call_details.method.startswith(OWN_SERVICES)
        if handler is None or handler.request_streaming or not ours:
            return handler
        read, write = _careful(handler.request_deserializer), handler.response_serializer
        if handler.response_streaming:
            stream = handler.unary_stream

            def streamed(request: Any, context: grpc.ServicerContext) -> Iterator[Any]:
                _refuse(request, context)
                yield from stream(request, context)

            return grpc.unary_stream_rpc_method_handler(streamed, read, write)
        unary = handler.unary_unary

        def answered(request: Any, context: grpc.ServicerContext) -> Any:
            _refuse(request, context)
            return unary(request, context)

        return grpc.unary_unary_rpc_method_handler(answered, read, write)


def _careful(read: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    """Return what reads a request, or says why it cannot."""

    def reading(data: bytes) -> Any:
        try:
            return read(data)
        except DecodeError:
            return InvalidInputError("request", f"{len(data)} bytes", "a message of this call")

    return reading


def _refuse(request: Any, context: grpc.ServicerContext) -> None:
    if isinstance(request, InvalidInputError):
        abort(context, request)
