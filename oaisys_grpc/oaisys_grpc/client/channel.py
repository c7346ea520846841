"""A client's connection to one simulator: its requests, its calls, its errors."""

from __future__ import annotations

import contextlib
import time
import uuid
from collections.abc import Iterator, Sequence
from typing import Any

import grpc
from google.protobuf.duration_pb2 import Duration
from grpc_health.v1 import health_pb2, health_pb2_grpc

from oaisys_core.errors import (
    CancelledError,
    DeadlineExceededError,
    InvalidInputError,
    NotReadyError,
    OaisysError,
    WorkerStartingError,
)
from oaisys_core.types import ModuleMetadata, Pose
from oaisys_grpc.addresses import grpc_target
from oaisys_grpc.contract.connection_names import new_client_entry
from oaisys_grpc.contract.errors import REASON_KEY, error_from_rpc
from oaisys_grpc.contract.metadata import metadata_to_proto, pose_to_proto
from oaisys_grpc.contract.transfer import Transfer, transfer_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc
from oaisys_grpc.tls import ClientTls

SERVICE = "oaisys.v1.SimulatorService"

_OPTIONS = [
    # A server that was replaced is found again at once; the default waits up to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
    # A simulator is not reached through a web proxy.
    ("grpc.enable_http_proxy", 0),
    # By default, the server often waits for the client's window, and sends pieces of 16 KiB.
    ("grpc.http2.lookahead_bytes", 64 << 20),
    ("grpc.http2.bdp_probe", 0),
    ("grpc.http2.max_frame_size", (1 << 24) - 1),
]
_HEALTH_POLL_S = 0.1


class Channel:
    """The calls of one simulator; safe to share between threads."""

    def __init__(self, address: str, tls: ClientTls | None) -> None:
        """Prepare a connection; nothing is sent yet.

        Raises:
            InvalidInputError: A certificate or key cannot be used.
        """
        target = grpc_target(address)
        self.address = address
        self._metadata = (new_client_entry(),)
        if tls is None:
            self._channel = grpc.insecure_channel(target, options=_OPTIONS)
        else:
            self._channel = grpc.secure_channel(target, tls.credentials(), options=_OPTIONS)
        self._stub = simulator_pb2_grpc.SimulatorServiceStub(self._channel)
        self._health = health_pb2_grpc.HealthStub(self._channel)

    def call(self, name: str, request: Any, timeout_s: float) -> Any:
        """Call a method that answers with one message, and return that."""
        with translate_errors():
            return getattr(self._stub, name)(request, timeout=timeout_s, metadata=self._metadata)

    @contextlib.contextmanager
    def stream(self, name: str, request: Any, timeout_s: float | None) -> Iterator[Any]:
        """Call a method that answers with a stream; the end of the block ends the call.

        Yields the call: an iterator over the answers, which any thread may cancel. Without a
        timeout, it may take as long as it takes.
        """
        with translate_errors():
            method = getattr(self._stub, name)
            call = method(request, timeout=timeout_s, metadata=self._metadata)
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
        while True:
            try:
                return self.check_ready(max(0.01, min(1.0, end_s - time.monotonic())))
            except OaisysError as error:
                if time.monotonic() >= end_s:
                    raise DeadlineExceededError(f"{error} (after {timeout_s:g} s)") from error
            time.sleep(_HEALTH_POLL_S)

    def check_ready(self, timeout_s: float) -> None:
        """Ask whether the simulator serves.

        Raises:
            WorkerStartingError: It answers, and its worker is being started.
            NotReadyError: It does not say so within ``timeout_s`` seconds; the message says why.
        """
        request = health_pb2.HealthCheckRequest(service=SERVICE)
        nobody = f"no simulator serves at {self.address}"
        try:
            with translate_errors():
                answer, call = self._health.Check.with_call(
                    request, timeout=timeout_s, metadata=self._metadata
                )
        except OaisysError as error:
            raise NotReadyError(f"{nobody}: {error}") from error
        if answer.status != health_pb2.HealthCheckResponse.SERVING:
            if reason := dict(call.trailing_metadata() or ()).get(REASON_KEY):
                raise NotReadyError(f"{nobody}: {reason}")
            raise WorkerStartingError(f"the simulator at {self.address} is starting its worker")

    def is_ready(self, timeout_s: float) -> bool:
        """Return whether the simulator says within ``timeout_s`` seconds that it serves."""
        try:
            self.check_ready(timeout_s)
        except OaisysError:
            return False
        return True

    def close(self) -> None:
        """Close the connection."""
        self._channel.close()


@contextlib.contextmanager
def translate_errors() -> Iterator[None]:
    """Raise the error that a failed call stands for."""
    try:
        yield
    except grpc.RpcError as error:
        raise error_from_rpc(error) from error
    except ValueError as error:
        # gRPC raises this where another thread has closed the channel.
        if "closed" not in str(error):
            raise
        raise CancelledError("the connection was closed") from error


def batch_request(
    timeout_s: float,
    seed: int | None,
    reuse_stage: bool,
    metadata: ModuleMetadata | None,
    request_id: str,
) -> pb.StepBatchRequest:
    """Return a request for a new world.

    Raises:
        InvalidInputError: The seed or the metadata do not fit into a message.
    """
    if seed is not None and not -(2**63) <= seed < 2**63:
        raise InvalidInputError("seed", seed, "a whole number from 0 to 2**63 - 1")
    return pb.StepBatchRequest(
        request_id=request_id or _new_id(),
        metadata=_metadata(None, metadata),
        seed=seed,
        reuse_stage=reuse_stage,
        timeout=_duration(timeout_s),
    )


def sample_request(
    timeout_s: float,
    pose: Pose | None,
    metadata: ModuleMetadata | None,
    modalities: Sequence[str],
    sensors: Sequence[str],
    request_id: str,
) -> pb.StepSampleRequest:
    """Return a request for a sample; a pose goes before that of the metadata.

    Raises:
        InvalidInputError: The metadata do not fit into a message.
    """
    return pb.StepSampleRequest(
        request_id=request_id or _new_id(),
        metadata=_metadata(pose, metadata),
        modalities=modalities,
        sensors=sensors,
        timeout=_duration(timeout_s),
    )


def render_request(
    pose: Pose | None,
    metadata: ModuleMetadata | None,
    modalities: Sequence[str],
    sensors: Sequence[str],
    transfer: Transfer,
) -> pb.RenderSampleRequest:
    """Return a request for a sample whose frames the same call brings; see `sample_request`."""
    return pb.RenderSampleRequest(
        request_id=_new_id(),
        metadata=_metadata(pose, metadata),
        modalities=modalities,
        sensors=sensors,
        transfer=transfer_to_proto(transfer),
    )


def _metadata(pose: Pose | None, metadata: ModuleMetadata | None) -> pb.ModuleMetadata | None:
    if pose is None:
        return None if metadata is None else metadata_to_proto(metadata)
    message = metadata_to_proto(metadata or ModuleMetadata())
    message.sensor.pose.CopyFrom(pose_to_proto(pose))
    return message


def _duration(seconds: float) -> Duration:
    duration = Duration()
    duration.FromMilliseconds(int(seconds * 1000))
    return duration


def _new_id() -> str:
    return uuid.uuid4().hex
