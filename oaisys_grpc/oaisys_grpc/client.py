"""A typed client of the simulator: the core's types and errors, without Blender or protobuf."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from types import TracebackType
from typing import Self

import grpc
import numpy as np
from grpc_health.v1 import health_pb2, health_pb2_grpc
from numpy.typing import ArrayLike

from oaisys_core.errors import (
    CancelledError,
    DeadlineExceededError,
    InvalidInputError,
    OaisysError,
)
from oaisys_core.types import (
    HeightQuery,
    ModuleMetadata,
    Pose,
    Progress,
    Sample,
    SampleFramesCallback,
    SimulatorInfo,
    TriangleMesh,
    ignore_sample_frames,
)
from oaisys_grpc import chunks, conversions, requests
from oaisys_grpc.errors import error_from_rpc
from oaisys_grpc.operation import OperationStatus, status_from_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2_grpc
from oaisys_grpc.sample_stream import SampleStream, sample_from_parts
from oaisys_grpc.tls import ClientTls, client_tls

__all__ = ["ClientTls", "SimulatorClient", "client_tls"]

DEFAULT_ADDRESS = "127.0.0.1:50051"
DEFAULT_TIMEOUT_S = 120.0
SERVICE = "oaisys.v1.SimulatorService"

ProgressListener = Callable[[Progress], None]

_CHANNEL_OPTIONS = [
    # A server that was replaced is found again at once; the default waits up to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
    # A proxy for the web is none for a simulator on this machine.
    ("grpc.enable_http_proxy", 0),
]
_HEIGHTS_PER_CALL = 50_000
_HEALTH_POLL_S = 0.1


class SimulatorClient:
    """Talks to one simulator; a context manager, and safe to share between threads.

    Every method raises the same `oaisys_core.errors` that the simulator raised, an
    `InvalidInputError` with its field, and besides `DeadlineExceededError` after ``timeout_s`` and
    `oaisys_grpc.faults.ServerUnavailableError` where no server answers.
    """

    def __init__(
        self,
        address: str = DEFAULT_ADDRESS,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        tls: ClientTls | None = None,
    ) -> None:
        """Prepare a connection; nothing is sent yet.

        Args:
            address: ``host:port`` or ``unix:PATH``.
            timeout_s: How long a call may take, rendering and waiting in the queue included.
            tls: For a server that encrypts; None: without.

        Raises:
            InvalidInputError: A certificate or key cannot be used.
        """
        self._address = address
        self._timeout_s = timeout_s
        if tls is None:
            self._channel = grpc.insecure_channel(address, options=_CHANNEL_OPTIONS)
        else:
            credentials = tls.credentials()
            self._channel = grpc.secure_channel(address, credentials, options=_CHANNEL_OPTIONS)
        self._stub = simulator_pb2_grpc.SimulatorServiceStub(self._channel)
        self._health = health_pb2_grpc.HealthStub(self._channel)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def wait_ready(self, timeout_s: float) -> None:
        """Wait until the simulator serves.

        Raises:
            DeadlineExceededError: It does not within ``timeout_s`` seconds.
        """
        end_s = time.monotonic() + timeout_s
        while not self.is_ready(max(0.01, min(1.0, end_s - time.monotonic()))):
            if time.monotonic() >= end_s:
                message = f"no simulator serves at {self._address} after {timeout_s:g} s"
                raise DeadlineExceededError(message)
            time.sleep(_HEALTH_POLL_S)

    def is_ready(self, timeout_s: float = 1.0) -> bool:
        """Return whether the simulator says within ``timeout_s`` seconds that it serves."""
        request = health_pb2.HealthCheckRequest(service=SERVICE)
        try:
            with _translated():
                answer = self._health.Check(request, timeout=timeout_s)
        except OaisysError:
            return False
        return bool(answer.status == health_pb2.HealthCheckResponse.SERVING)

    def info(self) -> SimulatorInfo:
        """Return what the simulator is and where it stands."""
        with _translated():
            request = pb.GetSimulatorInfoRequest()
            message = self._stub.GetSimulatorInfo(request, timeout=self._timeout_s)
        return conversions.info_from_proto(message)

    def step_batch(
        self,
        *,
        seed: int | None = None,
        reuse_stage: bool = False,
        metadata: ModuleMetadata | None = None,
        on_progress: ProgressListener | None = None,
    ) -> int:
        """Build a new world, wait until it stands, and return its batch id.

        Args:
            seed: Seed of this world; None derives it from the root seed and the batch id.
            reuse_stage: Keep the ground and its materials.
            metadata: Parts for the modules.
            on_progress: Told how far it is, on this thread.
        """
        name = self.start_batch(seed=seed, reuse_stage=reuse_stage, metadata=metadata)
        try:
            for status in self.watch_operation(name):
                if on_progress is not None:
                    on_progress(status.progress)
        except BaseException:
            with contextlib.suppress(OaisysError):
                self.cancel_operation(name)
            raise
        if status.error is not None:
            raise status.error
        return status.batch_id

    def render_sample(
        self,
        pose: Pose | None = None,
        *,
        metadata: ModuleMetadata | None = None,
        modalities: Sequence[str] = (),
        sensors: Sequence[str] = (),
        on_progress: ProgressListener | None = None,
        on_frames: SampleFramesCallback = ignore_sample_frames,
    ) -> Sample:
        """Move the rig, render, and return the frames.

        Args:
            pose: Where the rig goes, in ``map``; None: where it is, or where the metadata says.
            metadata: What else changes from here on.
            modalities: Which of them to render; none named: all of each sensor.
            sensors: Which of them to render; none named: all.
            on_progress: Told how far it is, on this thread. If it raises, the render is cancelled.
            on_frames: Told each frame as soon as it comes: depth and labels before any colour. If
                this method raises afterwards, these frames belong to no sample.
        """
        with self.stream_sample(
            pose,
            metadata=metadata,
            modalities=modalities,
            sensors=sensors,
            on_progress=on_progress,
        ) as stream:
            for frame in stream:
                on_frames(stream.outline, (frame,))
            return stream.sample

    @contextlib.contextmanager
    def stream_sample(
        self,
        pose: Pose | None = None,
        *,
        metadata: ModuleMetadata | None = None,
        modalities: Sequence[str] = (),
        sensors: Sequence[str] = (),
        on_progress: ProgressListener | None = None,
    ) -> Iterator[SampleStream]:
        """Move the rig and render, in a ``with`` block: iterate over the frames as they come.

        Leaving the block before the last frame cancels the render. See `render_sample`.
        """
        request = requests.render_sample(pose, metadata, modalities, sensors)
        with _translated():
            call = self._stub.RenderSample(request, timeout=self._timeout_s)
            try:
                yield SampleStream(_parts_after_progress(call, on_progress))
            finally:
                call.cancel()

    def start_batch(
        self,
        *,
        seed: int | None = None,
        reuse_stage: bool = False,
        metadata: ModuleMetadata | None = None,
        request_id: str = "",
    ) -> str:
        """Ask for a new world and return the operation's name at once.

        Args:
            request_id: Makes a repeated request harmless; empty: this call is a new request.
        """
        request = requests.step_batch(
            self._timeout_s, seed, reuse_stage, metadata, request_id=request_id
        )
        with _translated():
            answer = self._stub.StepBatch(request, timeout=self._timeout_s)
        return answer.operation.name

    def start_sample(
        self,
        pose: Pose | None = None,
        *,
        metadata: ModuleMetadata | None = None,
        modalities: Sequence[str] = (),
        sensors: Sequence[str] = (),
        request_id: str = "",
    ) -> str:
        """Ask for a sample and return the operation's name at once; see `render_sample`."""
        request = requests.step_sample(
            self._timeout_s, pose, metadata, modalities, sensors, request_id=request_id
        )
        with _translated():
            answer = self._stub.StepSample(request, timeout=self._timeout_s)
        return answer.operation.name

    def get_operation(self, name: str) -> OperationStatus:
        """Return how an operation stands."""
        with _translated():
            request = pb.GetOperationRequest(name=name)
            answer = self._stub.GetOperation(request, timeout=self._timeout_s)
        return status_from_proto(answer.operation)

    def watch_operation(self, name: str) -> Iterator[OperationStatus]:
        """Yield how an operation stands, at each change until it has ended."""
        with _translated():
            request = pb.WatchOperationRequest(name=name)
            call = self._stub.WatchOperation(request, timeout=self._timeout_s)
            try:
                for answer in call:
                    yield status_from_proto(answer.operation)
            finally:
                call.cancel()

    def cancel_operation(self, name: str) -> OperationStatus:
        """Ask an operation to stop, and return how it stands now."""
        with _translated():
            request = pb.CancelOperationRequest(name=name)
            answer = self._stub.CancelOperation(request, timeout=self._timeout_s)
        return status_from_proto(answer.operation)

    def get_sample(self, batch_id: int, sample_id: int) -> Sample:
        """Return a sample that was rendered lately."""
        with _translated():
            request = pb.GetSampleRequest(batch_id=batch_id, sample_id=sample_id)
            call = self._stub.GetSample(request, timeout=self._timeout_s)
            return sample_from_parts(answer.part for answer in call)

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return the surface of the world as rendered, in ``map``."""
        with _translated():
            request = pb.GetGroundTruthMeshRequest()
            call = self._stub.GetGroundTruthMesh(request, timeout=self._timeout_s)
            return chunks.mesh_from_parts(call)

    def query_height(self, points_m: ArrayLike) -> HeightQuery:
        """Return the heights under (N, 3) points in ``map``; NaN off the stage."""
        points = np.asarray(points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InvalidInputError("points_m", points.shape, "(N, 3) coordinates")
        answers = []
        for begin in range(0, max(1, len(points)), _HEIGHTS_PER_CALL):
            block = points[begin : begin + _HEIGHTS_PER_CALL]
            request = pb.QueryHeightRequest(points_m=block.ravel().tolist())
            with _translated():
                message = self._stub.QueryHeight(request, timeout=self._timeout_s)
            answers.append(conversions.heights_from_proto(message))
        return HeightQuery(
            ground_height_m=np.concatenate([a.ground_height_m for a in answers]),
            surface_height_m=np.concatenate([a.surface_height_m for a in answers]),
            clearance_m=np.concatenate([a.clearance_m for a in answers]),
        )

    def end_simulation(self) -> None:
        """End the simulator: its worker and the server's process."""
        with _translated():
            self._stub.EndSimulation(pb.EndSimulationRequest(), timeout=self._timeout_s)

    def close(self) -> None:
        """Close the connection; the simulator goes on."""
        self._channel.close()


@contextlib.contextmanager
def _translated() -> Iterator[None]:
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


def _parts_after_progress(
    events: Iterable[pb.RenderSampleResponse], on_progress: ProgressListener | None
) -> Iterator[pb.SamplePart]:
    """Tell the listener what precedes the sample; yield the sample's parts."""
    with _translated():
        for event in events:
            if event.HasField("part"):
                yield event.part
            elif on_progress is not None:
                on_progress(conversions.progress_from_proto(event.operation.progress))
