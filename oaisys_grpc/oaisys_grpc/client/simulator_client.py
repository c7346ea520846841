"""A typed client of the simulator: the core's types and errors, without Blender or protobuf."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.types import (
    HeightGrid,
    HeightQuery,
    ModuleMetadata,
    ObjectPage,
    ObjectQuery,
    PlannedTrajectory,
    Pose,
    Sample,
    SimulatorInfo,
    TimedPoses,
    TriangleMesh,
)
from oaisys_grpc.addresses import DEFAULT_ADDRESS
from oaisys_grpc.client.channel import Channel, batch_request, render_request, sample_request
from oaisys_grpc.client.drive_stream import DriveStream
from oaisys_grpc.client.sample_client import ProgressListener, SampleClient
from oaisys_grpc.client.sample_stream import MAX_ARRAY_BYTES, SampleStream
from oaisys_grpc.contract import world_messages as world
from oaisys_grpc.contract.arrays import encodings_from_names
from oaisys_grpc.contract.drive_messages import poses_to_proto, trajectory_from_proto
from oaisys_grpc.contract.metadata import metadata_to_proto, struct_to_proto
from oaisys_grpc.contract.operation import OperationStatus, status_from_proto
from oaisys_grpc.contract.transfer import transfer_to_proto
from oaisys_grpc.pb.oaisys.v1 import simulator_pb2 as pb
from oaisys_grpc.tls import ClientTls, client_tls

__all__ = [
    "DEFAULT_ADDRESS",
    "ClientTls",
    "DriveStream",
    "ProgressListener",
    "SampleStream",
    "SimulatorClient",
    "client_tls",
]

DEFAULT_TIMEOUT_S = 120.0

_HEIGHTS_PER_CALL = 50_000


class SimulatorClient:
    """Talks to one simulator; a context manager, and safe to share between threads.

    Every method raises the same `oaisys_core.errors` that the simulator raised, an
    `InvalidInputError` with its field, and besides `DeadlineExceededError` after ``timeout_s`` and
    `oaisys_grpc.contract.faults.ServerUnavailableError` where no server answers.
    """

    def __init__(
        self,
        address: str = DEFAULT_ADDRESS,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        tls: ClientTls | None = None,
        shared_memory: bool = True,
        encodings: Sequence[str] = (),
        max_array_bytes: int = MAX_ARRAY_BYTES,
    ) -> None:
        """Prepare a connection; nothing is sent yet.

        Args:
            address: ``host:port`` or ``unix:PATH``.
            timeout_s: How long a call may take, rendering and waiting in the queue included.
            tls: For a server that encrypts; None: without.
            shared_memory: Read images in the server's memory where that is on this machine; they
                come through the connection where it is not.
            encodings: In which of ``png`` and ``shuffled_zlib`` images may come through the
                connection, the preferred one first; none: not compressed. They are lossless.
            max_array_bytes: A larger image, or array of a mesh, is refused before it is received.

        Raises:
            InvalidInputError: A certificate or key cannot be used, or there is no such encoding.
        """
        self._timeout_s = timeout_s
        self._max_array_bytes = max_array_bytes
        accepted = encodings_from_names(encodings)
        self._channel = Channel(address, tls)
        self._samples = SampleClient(
            self._channel, accepted, max_array_bytes, shared_memory=shared_memory
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def wait_ready(self, timeout_s: float) -> None:
        """Wait until the simulator serves.

        Raises:
            DeadlineExceededError: It does not within ``timeout_s`` seconds.
        """
        self._channel.wait_ready(timeout_s)

    def check_ready(self, timeout_s: float = 1.0) -> None:
        """Ask whether the simulator serves.

        Raises:
            WorkerStartingError: It answers, and its worker is being started.
            NotReadyError: It does not say so within ``timeout_s`` seconds; the message says why.
        """
        self._channel.check_ready(timeout_s)

    def is_ready(self, timeout_s: float = 1.0) -> bool:
        """Return whether the simulator says within ``timeout_s`` seconds that it serves."""
        return self._channel.is_ready(timeout_s)

    def info(self) -> SimulatorInfo:
        """Return a description of the simulator and its current batch and sample."""
        return world.info_from_proto(self._call("GetSimulatorInfo", pb.GetSimulatorInfoRequest()))

    def config_json(self) -> str:
        """Return the simulator's whole configuration as JSON; empty: the server is older."""
        request = pb.GetSimulatorInfoRequest(with_config=True)
        return str(self._call("GetSimulatorInfo", request).config_json)

    def step_batch(
        self,
        *,
        seed: int | None = None,
        reuse_stage: bool = False,
        metadata: ModuleMetadata | None = None,
        on_progress: ProgressListener | None = None,
    ) -> int:
        """Build a new world, wait until it is built, and return its batch id.

        Args:
            seed: Seed of this world; None derives it from the root seed and the batch id.
            reuse_stage: Keep the ground and its materials.
            metadata: Parts for the modules.
            on_progress: Called on this thread with the progress.
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
    ) -> Sample:
        """Move the rig, render, and return the frames.

        Args:
            pose: Where the rig goes, in ``map``; None: where it is, or where the metadata says.
            metadata: What else changes from here on.
            modalities: Which of them to render; none named: all of each sensor.
            sensors: Which of them to render; none named: all.
            on_progress: Called on this thread with the progress; if it raises, the render ends.
        """
        with self.stream_sample(
            pose, metadata=metadata, modalities=modalities, sensors=sensors, on_progress=on_progress
        ) as stream:
            return stream.read()

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

        Depth and labels come before any colour. Leaving the block before the last frame cancels
        the render; the frames that came then belong to no sample. See `render_sample`.
        """
        transfer = self._samples.transfer(self._timeout_s)
        request = render_request(pose, metadata, modalities, sensors, transfer)
        with self._samples.render(request, self._timeout_s, on_progress) as stream:
            yield stream

    def set_trajectory(
        self, poses: TimedPoses | None = None, *, drive: Mapping[str, Any] | None = None
    ) -> PlannedTrajectory:
        """Have a trajectory planned in the current world, and kept for `drive`.

        Args:
            poses: The motion itself; None: a vehicle drives as the configuration's section
                ``drive`` says.
            drive: Keys of that section that replace the configured ones, such as ``waypoints_m``.
        """
        request = pb.SetTrajectoryRequest()
        if poses is not None:
            request.poses.CopyFrom(poses_to_proto(poses))
        if drive:
            request.drive.CopyFrom(struct_to_proto(drive, "drive"))
        return trajectory_from_proto(self._call("SetTrajectory", request).trajectory)

    @contextlib.contextmanager
    def drive(
        self,
        trajectory: str = "",
        *,
        sensors: Sequence[str] = (),
        metadata: ModuleMetadata | None = None,
        timeout_s: float | None = None,
        on_progress: ProgressListener | None = None,
    ) -> Iterator[DriveStream]:
        """Drive along a trajectory, in a ``with`` block: iterate over its instants as they come.

        The drive waits while the caller does not read. Leaving the block ends it.

        Args:
            trajectory: Name of a trajectory that was set; empty: the one that was set last.
            sensors: Names of cameras, lidars and IMUs, and ``odometry``; none named: all.
            metadata: What changes with the first sample, without a pose.
            timeout_s: How long the whole drive may take; None: as long as it takes.
            on_progress: Called on this thread with the progress of the whole drive.
        """
        transfer = self._samples.byte_transfer()
        request = pb.DriveRequest(
            trajectory=trajectory, sensors=sensors, transfer=transfer_to_proto(transfer)
        )
        if metadata is not None:
            request.metadata.CopyFrom(metadata_to_proto(metadata))
        with self._channel.stream("Drive", request, timeout_s) as call:
            yield DriveStream(
                call,
                frame_bytes=self._max_array_bytes,
                on_progress=on_progress,
                cancel=call.cancel,
            )

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
        request = batch_request(self._timeout_s, seed, reuse_stage, metadata, request_id=request_id)
        return str(self._call("StepBatch", request).operation.name)

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
        request = sample_request(self._timeout_s, pose, metadata, modalities, sensors, request_id)
        return str(self._call("StepSample", request).operation.name)

    def get_operation(self, name: str) -> OperationStatus:
        """Return the status of an operation."""
        answer = self._call("GetOperation", pb.GetOperationRequest(name=name))
        return status_from_proto(answer.operation)

    def watch_operation(self, name: str) -> Iterator[OperationStatus]:
        """Yield the status of an operation at each change until it has ended."""
        request = pb.WatchOperationRequest(name=name)
        with self._channel.stream("WatchOperation", request, self._timeout_s) as call:
            for answer in call:
                yield status_from_proto(answer.operation)

    def cancel_operation(self, name: str) -> OperationStatus:
        """Cancel an operation, and return its status."""
        answer = self._call("CancelOperation", pb.CancelOperationRequest(name=name))
        return status_from_proto(answer.operation)

    def get_sample(self, batch_id: int, sample_id: int) -> Sample:
        """Return a recent sample."""
        return self._samples.fetch_sample(batch_id, sample_id, self._timeout_s)

    def ground_truth_mesh(self) -> TriangleMesh:
        """Return the surface of the world as rendered, in ``map``."""
        request = pb.GetGroundTruthMeshRequest()
        with self._channel.stream("GetGroundTruthMesh", request, self._timeout_s) as parts:
            return world.mesh_from_parts(parts, self._max_array_bytes)

    def height_grid(
        self, resolution_m: float, extent_m: tuple[float, float, float, float] | None = None
    ) -> HeightGrid:
        """Return the heights of ground and topmost surface on a grid.

        Args:
            resolution_m: Edge of a cell.
            extent_m: (min_x, min_y, max_x, max_y) in ``map``; None: the whole stage.
        """
        request = pb.GetHeightFieldRequest(resolution_m=resolution_m)
        if extent_m is not None:
            request.extent.CopyFrom(world.extent_to_proto(extent_m))
        with self._channel.stream("GetHeightField", request, self._timeout_s) as parts:
            return world.heights_from_parts(parts, self._max_array_bytes)

    def query_height(self, points_m: ArrayLike) -> HeightQuery:
        """Return the heights under (N, 3) points in ``map``; NaN where there is no ground."""
        points = np.asarray(points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InvalidInputError("points_m", points.shape, "(N, 3) coordinates")
        begins = range(0, max(1, len(points)), _HEIGHTS_PER_CALL)
        blocks = (points[begin : begin + _HEIGHTS_PER_CALL].ravel().tolist() for begin in begins)
        requests = (pb.QueryHeightRequest(points_m=block) for block in blocks)
        answers = [world.heights_from_proto(self._call("QueryHeight", r)) for r in requests]
        return HeightQuery(
            ground_height_m=np.concatenate([a.ground_height_m for a in answers]),
            surface_height_m=np.concatenate([a.surface_height_m for a in answers]),
            clearance_m=np.concatenate([a.clearance_m for a in answers]),
        )

    def list_objects(
        self, query: ObjectQuery | None = None, metadata: ModuleMetadata | None = None
    ) -> ObjectPage:
        """Return one page of the objects in the world.

        Args:
            query: Which of them, and how many at most; None: the first thousand.
            metadata: List the objects as a sample with this metadata would leave them.
        """
        request = world.query_to_proto(query or ObjectQuery(), metadata)
        return world.page_from_proto(self._call("ListObjects", request))

    def end_simulation(self) -> None:
        """End the simulator: its worker and the server's process."""
        self._call("EndSimulation", pb.EndSimulationRequest())

    def close(self) -> None:
        """Close the connection; the simulator goes on."""
        self._channel.close()

    def _call(self, name: str, request: Any) -> Any:
        return self._channel.call(name, request, self._timeout_s)
