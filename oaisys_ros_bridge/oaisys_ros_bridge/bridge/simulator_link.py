"""What the bridge asks the simulator for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from numpy.typing import ArrayLike

from oaisys_core.errors import NotReadyError
from oaisys_core.types import (
    MAX_OBJECTS,
    HeightGrid,
    HeightQuery,
    ModuleMetadata,
    ObjectPage,
    ObjectQuery,
    Pose,
    SceneObject,
    TriangleMesh,
)
from oaisys_grpc.client.simulator_client import DriveStream, SampleStream
from oaisys_ros_bridge.bridge.requests import DriveRequest, ViewRequest
from oaisys_ros_bridge.bridge.simulator_connection import SimulatorConnection

MESH_ATTEMPTS = 3
"""At a mesh, while other clients build worlds."""


class SimulatorLink(SimulatorConnection):
    """The calls of the bridge, each by the connection's client.

    Errors of a call tell the connection what they say of the server.
    """

    @contextmanager
    def sample_stream(
        self, rig_pose: Pose | None, request: ViewRequest, metadata: ModuleMetadata | None
    ) -> Iterator[SampleStream]:
        """Render a sample, in a ``with`` block: iterate over its frames as they come.

        Args:
            rig_pose: Where the rig goes; None: it stays.
            request: Which sensor and modalities are rendered.
            metadata: What else changes from this sample on.

        Raises:
            OaisysError: As the server says, or there is none.
        """
        sensors = [request.sensor] if request.sensor else []
        with (
            self.lock,
            self.lend_client(waits=False) as client,
            client.stream_sample(
                rig_pose, metadata=metadata, modalities=request.modalities, sensors=sensors
            ) as stream,
        ):
            yield stream

    @contextmanager
    def drive(
        self, request: DriveRequest, metadata: ModuleMetadata | None
    ) -> Iterator[DriveStream]:
        """Drive, in a ``with`` block: iterate over the instants as they come.

        Builds the first batch where there is none and one is wanted.

        Args:
            request: The motion, and the sensors that measure.
            metadata: What else changes from the first sample on.

        Raises:
            OaisysError: As the server says, or there is none.
        """
        with self.lock:
            self.check()
            with self.lend_client(waits=False) as client:
                planned = client.set_trajectory(request.poses, drive=request.changes)
                with client.drive(
                    planned.name, sensors=request.sensors, metadata=metadata
                ) as stream:
                    yield stream

    def step_batch(
        self, *, seed: int | None, reuse_stage: bool, metadata: ModuleMetadata | None
    ) -> int:
        """Build a new batch and return its id; it overtakes a sample that is being rendered."""
        with self.lend_client() as client, self.note_building():
            batch_id = client.step_batch(seed=seed, reuse_stage=reuse_stage, metadata=metadata)
        self.check()
        return batch_id

    def list_objects(self, query: ObjectQuery, metadata: ModuleMetadata | None) -> ObjectPage:
        """Return objects of the world as they will be after ``metadata``; changes nothing.

        Raises:
            OaisysError: As the server says, or there is none.
        """
        with self.lend_client() as client:
            return client.list_objects(query, metadata)

    def find_objects(self, instance_ids: Sequence[int]) -> list[SceneObject]:
        """Return the objects of some ids, as they stand now.

        Raises:
            OaisysError: As the server says, or there is none.
        """
        found: list[SceneObject] = []
        for first in range(0, len(instance_ids), MAX_OBJECTS):
            ids = tuple(instance_ids[first : first + MAX_OBJECTS])
            page = self.list_objects(ObjectQuery(instance_ids=ids, limit=MAX_OBJECTS), None)
            found += page.objects
        return found

    def query_height(self, points_m: ArrayLike) -> HeightQuery:
        """Return the heights under (N, 3) points in ``map``.

        Raises:
            OaisysError: As the server says, or there is none.
        """
        with self.lend_client() as client:
            return client.query_height(points_m)

    def height_grid(
        self, resolution_m: float, extent_m: tuple[float, float, float, float]
    ) -> HeightGrid:
        """Return the heights in a rectangle (min x, min y, max x, max y) of ``map``.

        Raises:
            OaisysError: As the server says, or there is none.
        """
        with self.lend_client() as client:
            return client.height_grid(resolution_m, extent_m)

    def ground_truth_mesh(self) -> tuple[int, TriangleMesh]:
        """Return the true surface in ``map``, and the batch that it is of.

        Raises:
            OaisysError: As the server says, or there is none.
        """
        with self.lend_client() as client:
            for _ in range(MESH_ATTEMPTS):
                before = client.info().batch_id
                mesh = client.ground_truth_mesh()
                if client.info().batch_id == before:
                    return before, mesh
        raise NotReadyError("the world has changed while its mesh was sent")

    def end_simulation(self) -> None:
        """End the server's process, after the sample that is being rendered."""
        with self.lock:
            with self.lend_client(waits=False) as client:
                client.end_simulation()
            self.lose(NotReadyError("the simulation was ended"))
