"""A client's connection to one simulator: its channel, its calls, its errors."""

from __future__ import annotations

import collections
import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Self

import grpc
import grpc.experimental
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
    # Who iterates over a stream reads it, instead of being woken by a thread that does: `Stream`.
    (grpc.experimental.ChannelOptions.SingleThreadedUnaryStream, 1),
]
_HEALTH_POLL_S = 0.1


class Stream:
    """A call that brings messages; iterated over by one thread at a time, cancelled by any.

    A context manager, whose end is that of the call. grpcio keeps a call that was not heard out,
    18 KB, as long as its channel: what it still has to say is heard when the next stream begins, as
    who has what it wanted should not wait for that.
    """

    def __init__(self, call: Any, left: collections.deque[Stream]) -> None:
        """Take a call over.

        Args:
            left: Streams that are still to be heard out; this one goes there at its end.
        """
        self._call = call
        self._left = left
        self._reading = threading.Lock()

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        with self._reading:
            return next(self._call)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._call.cancel()
        self._left.append(self)

    def cancel(self) -> None:
        """End the call; who iterates over it gets an error."""
        self._call.cancel()

    def hear_out(self) -> None:
        """Let go of the call, which has ended."""
        with self._reading:
            # grpcio 1.85 has no public way to hear what a cancelled call still has to say.
            while self._call._state.due:  # noqa: SLF001
                self._call._consume_next_event()  # noqa: SLF001


class Channel:
    """The calls of one simulator; safe to share between threads.

    Attributes:
        stub: The unary calls as generated; its streams are not to be used.
        render_sample, get_sample, ground_truth_mesh, height_field, watch_operation: The streams.
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
        self._left: collections.deque[Stream] = collections.deque()
        self.stub = simulator_pb2_grpc.SimulatorServiceStub(self._channel)
        self._health = health_pb2_grpc.HealthStub(self._channel)
        self.render_sample = self._stream(self.stub.RenderSample)
        self.get_sample = self._stream(self.stub.GetSample)
        self.ground_truth_mesh = self._stream(self.stub.GetGroundTruthMesh)
        self.height_field = self._stream(self.stub.GetHeightField)
        self.watch_operation = self._stream(self.stub.WatchOperation)

    def _stream(self, begin: Callable[..., Any]) -> Callable[..., Stream]:
        def stream(request: Any, timeout: float) -> Stream:
            self._hear_out()
            return Stream(begin(request, timeout=timeout), self._left)

        return stream

    def _hear_out(self) -> None:
        with contextlib.suppress(IndexError):
            while True:
                self._left.popleft().hear_out()

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
        self._hear_out()
        self._channel.close()


@contextlib.contextmanager
def translated() -> Iterator[None]:
    """Turn a failed call into the error that it means."""
    try:
        yield
    except grpc.RpcError as error:
        raise error_from_rpc(error) from error
    except ValueError as error:
        # grpc's word for a client that another thread has closed meanwhile.
        if "closed" not in str(error):
            raise
        raise CancelledError("the connection was closed") from error
