"""The interface of a backend, which builds a scene and renders it from cameras."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from oaisys_core.errors import InvalidInputError, RenderError
from oaisys_core.scene import PlacedCamera, PlacedLidar, Scene
from oaisys_core.sensing.faults import CaptureId
from oaisys_core.sensing.render_settings import RenderSettings
from oaisys_core.types import (
    FloatArray,
    Frame,
    LidarScan,
    ProgressCallback,
    TriangleMesh,
    ignore_progress,
)


class FrameGroup:
    """Frames that become ready together; another thread may still be computing them.

    Attributes:
        scans: Scans of lidars, which are ready.
    """

    def __init__(
        self,
        compute: Callable[[], tuple[Frame, ...]],
        done: Callable[[], bool] = lambda: True,
        scans: tuple[LidarScan, ...] = (),
    ) -> None:
        """Compute nothing yet.

        Args:
            compute: Returns the frames; called once, by the first thread that asks for them.
            done: Whether ``compute`` returns without waiting for another thread.
            scans: Scans of lidars, which are ready.
        """
        self.scans = scans
        self._compute = compute
        self._done = done
        self._lock = threading.Lock()
        self._frames: tuple[Frame, ...] | None = None

    @classmethod
    def of(cls, frames: Iterable[Frame], scans: Iterable[LidarScan] = ()) -> FrameGroup:
        """Return a group of frames and scans that are ready."""
        ready = tuple(frames)
        return cls(lambda: ready, scans=tuple(scans))

    def is_done(self) -> bool:
        """Return whether `result` returns without waiting for another thread."""
        return self._done()

    def result(self) -> tuple[Frame, ...]:
        """Wait for the frames and return them.

        Raises:
            Exception: Whatever computing them raised.
        """
        with self._lock:
            if self._frames is None:
                self._frames = self._compute()
            return self._frames

    def map_frames(self, change: Callable[[tuple[Frame, ...]], tuple[Frame, ...]]) -> FrameGroup:
        """Return the group of the changed frames; ``change`` is called when they are asked for."""
        return FrameGroup(lambda: change(self.result()), self._done, self.scans)


class Backend(ABC):
    """Renders a `Scene`; one instance lives as long as its simulation.

    Every method may raise `RenderError`; none of them draws a random number.
    """

    name: str
    """``blender`` or ``analytic``."""

    device: str = "cpu"
    """Device that colour is rendered on, for provenance."""

    samples_per_pixel: int | None = None
    """Samples per pixel of the last colour images, the fewest of all cameras; None: as set."""

    exposures: Mapping[str, float] = MappingProxyType({})
    """Exposures of the last sample's images: in stops by the camera's name, of colour, and in
    seconds by ``<camera>.<modality>.exposure_time_s``, of digital numbers."""

    @property
    @abstractmethod
    def version(self) -> str:
        """Version of the renderer, for provenance."""

    @abstractmethod
    def build(self, scene: Scene, progress: ProgressCallback) -> None:
        """Replace the world by ``scene``; an unchanged ``stage_hash`` may keep the ground."""

    @abstractmethod
    def update(self, scene: Scene) -> None:
        """Change the built world to ``scene``, which differs by what a sample may change.

        Parts that are the same Python objects as before are kept, and so are small equal ones.
        """

    @abstractmethod
    def render(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback,
    ) -> Iterator[FrameGroup]:
        """Yield one frame per camera and modality, in groups, each as early as possible.

        The first group has the depth, labels and other geometry of all cameras; one group per
        colour image follows. The geometry may still be computed while colours are rendered. All
        groups are done when the generator ends; it raises the error of any of them.

        Depth is planar z at pixel centres, float32, ``+inf`` where nothing was hit; ids are exact
        and never mixed.

        Raises:
            RenderError: The backend failed.
            CancelledError: ``progress`` raised it.
        """

    def scan(self, lidar: PlacedLidar, capture: CaptureId) -> LidarScan:
        """Return what a lidar measures of the built world.

        Args:
            lidar: The lidar.
            capture: Identifies the scan, for its errors.

        Raises:
            RenderError: The backend has no lidars.
        """
        raise RenderError(f"the backend {self.name} has no lidars ({lidar.name})")

    def render_all(
        self,
        cameras: Sequence[PlacedCamera],
        settings: RenderSettings,
        progress: ProgressCallback = ignore_progress,
    ) -> tuple[Frame, ...]:
        """Render, and return the frames in the order of the cameras and of their modalities."""
        groups = list(self.render(cameras, settings, progress))
        return _in_order(cameras, [frame for group in groups for frame in group.result()])

    @abstractmethod
    def note_revisit(self, cameras: Sequence[PlacedCamera]) -> None:
        """Note that these views came from the cache and were not rendered."""

    def withdrawn(self) -> None:  # noqa: B027 - most backends remember nothing of a sample
        """Forget the last sample."""

    @abstractmethod
    def ground_truth_mesh(self) -> TriangleMesh:
        """Return the world's surface as rendered, in ``map``, with ids per triangle."""

    @abstractmethod
    def surface_height_m(self, xy_m: FloatArray) -> FloatArray:
        """Return (N,) heights of the topmost surface (ground or object) at (N, 2); NaN off it."""

    def save(self, path: Path) -> None:
        """Write the built world as a file of the backend's own format, such as ``.blend``.

        Raises:
            InvalidInputError: The backend has no such files.
        """
        raise InvalidInputError(
            "save_blend", self.name, "the backend blender, to save .blend files"
        )

    def close(self) -> None:  # noqa: B027 - most backends hold nothing
        """Release all resources; no method may be called afterwards."""


def _in_order(cameras: Sequence[PlacedCamera], frames: Sequence[Frame]) -> tuple[Frame, ...]:
    """Return the frames in the order of the cameras and of their modalities.

    Where cameras share a name, the frames of each modality are in the cameras' order already.
    """
    by_name: dict[tuple[str, str], list[Frame]] = {}
    for frame in reversed(frames):
        by_name.setdefault((frame.sensor, frame.modality), []).append(frame)
    return tuple(
        by_name[camera.name, name].pop() for camera in cameras for name in camera.modalities
    )
