"""The data source of a live view, and the one that reads a server over gRPC."""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from numpy.typing import NDArray

from oaisys_core.errors import NotFoundError
from oaisys_core.types import (
    DEPTH,
    INSTANCE,
    RGB,
    SEMANTIC_0,
    FloatArray,
    PinholeIntrinsics,
    Sample,
    SimulatorInfo,
)
from oaisys_grpc.client.simulator_client import ClientTls, SimulatorClient
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.rectification import rectify, rectify_camera
from oaisys_mapping.report.web_viewer import PosedImages

_LOG = logging.getLogger(__name__)

POLL_PERIOD_S = 0.3
"""How often a server is asked for a new sample."""

START_TIMEOUT_S = 600.0
"""A server that can be reached may still be building its world."""


@dataclass(frozen=True)
class LiveUpdate:
    """What is new since the last update.

    Attributes:
        new_world: Whether everything that was shown before is of another world.
        views: New views, in order.
        mesh: The newest mesh, or None.
    """

    new_world: bool = False
    views: list[PosedImages] = field(default_factory=list)
    mesh: ColoredMesh | None = None


class LiveSource(ABC):
    """Receives views and meshes; a context manager.

    Attributes:
        labels: Names of semantic ids.
        has_mesh: Whether the source has sent a mesh, so that none need be made of the views.
    """

    labels: Mapping[int, str]
    has_mesh: bool = False

    @abstractmethod
    def next_update(self, timeout_s: float) -> LiveUpdate | None:
        """Return the next update, or None after ``timeout_s``."""

    @abstractmethod
    def close(self) -> None:
        """Close the source."""

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the source."""
        self.close()


class GrpcSource(LiveSource):
    """Fetches the samples that other clients have rendered; the server keeps the newest ones."""

    def __init__(self, address: str, tls: ClientTls | None = None) -> None:
        """Connect to a server; ``tls`` is for one that encrypts.

        Raises:
            OaisysError: It cannot be reached.
        """
        self._client = SimulatorClient(address, timeout_s=START_TIMEOUT_S, tls=tls)
        info = self._client.info()
        self.labels = info.semantic_labels
        self._batch = info.batch_id
        # One before the newest, which is then shown at once.
        self._sample = max(0, info.sample_id - 1)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def next_update(self, timeout_s: float) -> LiveUpdate | None:
        """Return the samples since the last call, except those that the server has dropped."""
        deadline = time.monotonic() + timeout_s
        while True:
            info = self._client.info()
            if (info.batch_id, info.sample_id) != (self._batch, self._sample):
                return self._fetch(info)
            if time.monotonic() >= deadline:
                return None
            time.sleep(POLL_PERIOD_S)

    def _fetch(self, info: SimulatorInfo) -> LiveUpdate:
        new_world = info.batch_id != self._batch
        first = 1 if new_world else self._sample + 1
        self.labels = info.semantic_labels
        self._batch, self._sample = info.batch_id, info.sample_id
        views: list[PosedImages] = []
        for sample_id in range(first, info.sample_id + 1):
            try:
                views += _views_of(self._client.get_sample(info.batch_id, sample_id))
            except NotFoundError:
                continue
        return LiveUpdate(new_world, views)


def _views_of(sample: Sample) -> Iterator[PosedImages]:
    """Yield the images of each camera but fisheyes, which have no rectified images."""
    for sensor in dict.fromkeys(frame.sensor for frame in sample.frames):
        frames = {frame.modality: frame for frame in sample.frames if frame.sensor == sensor}
        images = {modality: frame.data for modality, frame in frames.items()}
        any_frame = next(iter(frames.values()))
        if any_frame.intrinsics.is_fisheye:
            _LOG.warning("%s is a fisheye, which the page does not show", sensor)
            continue
        name = f"{sample.batch_id}.{sample.sample_id} {sensor}"
        yield images_with_pose(name, images, any_frame.intrinsics, any_frame.T_map_camera)


def images_with_pose(
    name: str,
    images: Mapping[str, NDArray[Any]],
    intrinsics: PinholeIntrinsics,
    T_map_camera: FloatArray,
) -> PosedImages:
    """Return a camera's images as the page shows them: colour and depth rectified.

    Args:
        name: Of the view.
        images: By modality.
        intrinsics: Of the camera.
        T_map_camera: (4, 4) pose of its optical frame.
    """
    depth_m, rgb = images.get(DEPTH), images.get(RGB)
    if depth_m is not None:
        depth_m, rgb = rectify(depth_m, rgb, intrinsics)
    camera = PosedCamera(rectify_camera(intrinsics), T_map_camera)
    return PosedImages(
        name, rgb, depth_m, images.get(SEMANTIC_0), camera, instance_ids=images.get(INSTANCE)
    )
