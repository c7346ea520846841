"""A client's connection to one simulator: its channel, its calls, its errors."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from oaisys_core.errors import CancelledError, DeadlineExceededError, OaisysError
from oaisys_grpc.contract.errors import error_from_rpc
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc
from oaisys_grpc.tls import ClientTls

SERVICE = "oaisys.v1.SimulatorService"

_OPTIONS = [
    # A server that was replaced is found again at once; the default waits up to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
    # A proxy for the web is none for a simulator on this machine.
    ("grpc.enable_http_proxy", 0),
    # By default the server waits again and again for leave to send, and sends pieces of 16 KiB.
    ("grpc.http2.lookahead_bytes", 64 << 20),
    ("grpc.http2.bdp_probe", 0),
    ("grpc.http2.max_frame_size", (1 << 24) - 1),
]
_HEALTH_POLL_S = 0.1


class Channel:
    """The calls of one simulator; safe to share between threads.

    Attributes:
        stub: The calls as generated; those that answer with a stream are called by `stream`.
    """

    def __init__(self, address: str, tls: ClientTls | None) -> None:
        """Prepare a connection; nothing is sent yet.

        Raises:
            InvalidInputError: A certificate or key cannot be used.
        """
        self.address = address
        if tls is None:
            self._channel = grpc.insecure_channel(address, options=_OPTIONS)
        else:
            self._channel = grpc.secure_channel(address, tls.credentials(), options=_OPTIONS)
        self.stub = simulator_pb2_grpc.SimulatorServiceStub(self._channel)
        self._health = health_pb2_grpc.HealthStub(self._channel)

    @contextlib.contextmanager
    def stream(self, name: str, request: Any, timeout_s: float) -> Iterator[Any]:
        """Call a method that answers with a stream; the end of the block ends the call.

        Yields the call: an iterator over the answers, which any thread may cancel.
        """
        with translated():
            call = getattr(self.stub, name)(request, timeout=timeout_s)
            try:
                yield call
            finally:
                call.cancel()

    def wait_ready(self, timeout_s: float) -> None:
        """Wait until the simulator serves.

        Raises:
            DeadlineExceededError: It does not within ``timeout_s`` seconds.
        """
        end_s = time.monotonic() + timeout_s
        while not self.is_ready(max(0.01, min(1.0, end_s - time.monotonic()))):
            if time.monotonic() >= end_s:
                message = f"no simulator serves at {self.address} after {timeout_s:g} s"
                raise DeadlineExceededError(message)
            time.sleep(_HEALTH_POLL_S)

    def is_ready(self, timeout_s: float) -> bool:
        """Return whether the simulator says within ``timeout_s`` seconds that it serves."""
        request = health_pb2.HealthCheckRequest(service=SERVICE)
        try:
            with translated():
                answer = self._health.Check(request, timeout=timeout_s)
        except OaisysError:
            return False
        return bool(answer.status == health_pb2.HealthCheckResponse.SERVING)

    def close(self) -> None:
        """Close the connection."""
        self._channel.close()


@contextlib.contextmanager
def translated() -> Iterator[None]:
    """Raise the error that a failed call stands for."""
    try:
        yield
    except grpc.RpcError as error:
        raise error_from_rpc(error) from error
    except ValueError as error:
        # grpc's word for a client that another thread has closed meanwhile.
        if "closed" not in str(error):
            raise
        raise CancelledError("the connection was closed") from error
