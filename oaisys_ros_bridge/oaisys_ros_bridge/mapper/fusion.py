"""Fuses frames into a volume on a thread of its own, in order of arrival."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oaisys_core.errors import DeadlineExceededError, OaisysError
from oaisys_core.types import FloatArray, PinholeIntrinsics, ShortRepr
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.rectification import rectify, rectify_camera, rectify_labels
from oaisys_mapping.voxels.config import TsdfConfig

if TYPE_CHECKING:
    from oaisys_mapping.distance_field import DistanceField
    from oaisys_mapping.tsdf import TsdfVolume

QUEUE_FRAMES = 32
"""Frames that may wait: 70 MB at 640x480. Any further one is dropped and counted."""
QUEUE_BYTES = 2**30
"""Bytes that may wait; one frame may always wait."""

VOLUME_TIMEOUT_S = 120.0
"""For importing Open3D on a busy machine."""

NOT_FUSED = "frames that could not be fused"
QUEUE_FULL = "frames that found the mapper's queue full"
"""Reasons why a frame is not in the volume."""


@dataclass(frozen=True, repr=False)
class DepthFrame(ShortRepr):
    """A depth image to be fused, with its camera and pose.

    Attributes:
        stamp_ns: When it was taken.
        depth_m: (H, W) float32 planar depth, ``+inf`` where nothing was hit.
        rgb: (H, W, 3) uint8, or None.
        intrinsics: The camera; distorted images are rectified before they are fused.
        T_map_camera: (4, 4) pose of the optical frame.
        labels: (H, W) uint16 classes, or None.
    """

    stamp_ns: int
    depth_m: NDArray[np.float32]
    rgb: NDArray[np.uint8] | None
    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray
    labels: NDArray[np.uint16] | None = None

    @property
    def nbytes(self) -> int:
        """Size of its images."""
        images = (self.depth_m, self.rgb, self.labels)
        return sum(image.nbytes for image in images if image is not None)


@dataclass(frozen=True)
class FusionState:
    """Counts since the start or the last reset, and the newest frame's stamp and duration."""

    received: int = 0
    integrated: int = 0
    dropped: int = 0
    stamp_ns: int = 0
    integration_time_s: float = 0.0


class Fusion:
    """A volume, the thread that fills it, and the views that it was made from.

    The thread imports Open3D, which takes seconds, and makes the volume; meanwhile frames wait.

    Args:
        config: How the volume is made.
        on_change: Called on the thread after every frame.
        on_error: Called with the reason why a frame cannot be integrated.
        on_done: Called with a frame's stamp, and the reason why it is not in the volume or "".
    """

    def __init__(
        self,
        config: TsdfConfig,
        *,
        on_change: Callable[[FusionState], None],
        on_error: Callable[[str], None],
        on_done: Callable[[int, str], object] = lambda *_: None,
    ) -> None:
        self._config = config
        self._made_volume: Future[TsdfVolume] = Future()
        self._views: list[PosedCamera] = []
        self._state = FusionState()
        self._on_change = on_change
        self._on_error = on_error
        self._on_done = on_done
        self._frames: queue.Queue[tuple[int, DepthFrame] | None] = queue.Queue(QUEUE_FRAMES)
        self._resets = 0
        self._volume_lock = threading.Lock()
        self._settled = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="fusion", daemon=True)
        self._thread.start()

    @property
    def _volume(self) -> TsdfVolume:
        """The volume, once it is made.

        Raises:
            OaisysError: It could not be made.
            DeadlineExceededError: It is not made in time.
        """
        try:
            return self._made_volume.result(VOLUME_TIMEOUT_S)
        except TimeoutError:
            message = f"the map's volume was not made within {VOLUME_TIMEOUT_S:g} s"
            raise DeadlineExceededError(message) from None

    @property
    def state(self) -> FusionState:
        """Counts so far."""
        return self._state

    def add(self, frame: DepthFrame) -> bool:
        """Queue a frame; return False if there was no room and it was dropped."""
        if not self._put(frame):
            self._count(received=1, dropped=1)
            self._on_done(frame.stamp_ns, QUEUE_FULL)
            return False
        self._count(received=1)
        return True

    def _put(self, frame: DepthFrame) -> bool:
        with self._frames.mutex:
            waiting = [entry[1].nbytes for entry in self._frames.queue if entry is not None]
        if waiting and sum(waiting) + frame.nbytes > QUEUE_BYTES:
            return False
        try:
            self._frames.put_nowait((self._resets, frame))
        except queue.Full:
            return False
        return True

    def surface(self, timeout_s: float) -> tuple[ColoredMesh, tuple[PosedCamera, ...]]:
        """Return the surface of all frames received so far, and their views.

        Raises:
            DeadlineExceededError: Some of them are not integrated after ``timeout_s``.
        """
        with self.settle(timeout_s) as volume:
            return volume.extract_mesh(), tuple(self._views)

    def visible_surface(self) -> ColoredMesh:
        """Return the surface of the frames that are fused so far, without blocks stored on disk."""
        with self._volume_lock:
            return self._volume.extract_mesh(with_stored=False)

    @property
    def voxel_size_m(self) -> float:
        """Edge of a voxel."""
        return self._config.voxel_size_m

    def distance_field(self, low_m: ArrayLike, high_m: ArrayLike) -> DistanceField:
        """Return the distances to the surface of the frames that are fused so far, in a box.

        Raises:
            InvalidInputError: The box is empty or too large.
        """
        from oaisys_mapping.distance_field import distance_field  # imports Open3D

        with self._volume_lock:
            return distance_field(self._volume, low_m, high_m)

    @contextmanager
    def settle(self, timeout_s: float) -> Iterator[TsdfVolume]:
        """Lend the volume once all frames received so far are in it; none is fused meanwhile.

        Raises:
            DeadlineExceededError: Some of them are not integrated after ``timeout_s``.
        """
        self._wait_for(self._state.received, timeout_s)
        with self._volume_lock:
            yield self._volume

    @property
    def views(self) -> tuple[PosedCamera, ...]:
        """The views that the volume is made from."""
        return tuple(self._views)

    @property
    def newest(self) -> tuple[FusionState, PosedCamera | None, int]:
        """Counts, the view that they end with or None without any, and the number of resets."""
        with self._settled:
            return self._state, self._views[-1] if self._views else None, self._resets

    def reset(self) -> None:
        """Clear the volume, and drop the frames that wait."""
        with self._volume_lock:
            while not self._frames.empty():
                self._frames.get_nowait()
            self._volume.reset()
            with self._settled:
                self._resets += 1
                self._views.clear()
                self._state = FusionState()
                self._settled.notify_all()
        self._on_change(self._state)

    def close(self) -> None:
        """End the thread after the current frame."""
        while not self._frames.empty():
            self._frames.get_nowait()
        self._frames.put(None)
        self._thread.join()

    def _wait_for(self, received: int, timeout_s: float) -> None:
        def settle() -> bool:
            state = self._state
            return state.received < received or state.integrated + state.dropped >= received

        with self._settled:
            if not self._settled.wait_for(settle, timeout_s):
                message = f"{received} frames were not integrated within {timeout_s:g} s"
                raise DeadlineExceededError(message)

    def _run(self) -> None:
        self._make_volume()
        while (entry := self._frames.get()) is not None:
            resets, frame = entry
            with self._volume_lock:
                is_wanted = resets == self._resets
                fault = self._integrate(frame) if is_wanted else ""
            if is_wanted:
                self._on_done(frame.stamp_ns, fault)
            self._on_change(self._state)

    def _make_volume(self) -> None:
        try:
            from oaisys_mapping.tsdf import TsdfVolume

            self._made_volume.set_result(TsdfVolume(self._config))
        except Exception as error:  # noqa: BLE001 - raised for each frame and request
            failure = OaisysError(f"the map's volume cannot be made: {error!r}")
            self._made_volume.set_exception(failure)

    def _integrate(self, frame: DepthFrame) -> str:
        """Fuse a frame; return why that fails, or an empty string."""
        start_s = time.perf_counter()
        try:
            camera = rectify_camera(frame.intrinsics)
            depth_m, rgb = rectify(frame.depth_m, frame.rgb, frame.intrinsics)
            labels = None
            if frame.labels is not None:
                labels = rectify_labels(frame.labels, frame.intrinsics)
            self._volume.integrate(depth_m, rgb, camera, frame.T_map_camera, labels)
        except Exception as error:  # noqa: BLE001 - without this thread nothing is fused any more
            known = isinstance(error, OaisysError)
            self._on_error(str(error) if known else f"a frame cannot be fused: {error!r}")
            self._count(dropped=1)
            return NOT_FUSED
        duration_s = time.perf_counter() - start_s
        with self._settled:
            self._views.append(PosedCamera(camera, frame.T_map_camera))
            self._count(integrated=1, stamp_ns=frame.stamp_ns, duration_s=duration_s)
        return ""

    def _count(
        self,
        *,
        received: int = 0,
        integrated: int = 0,
        dropped: int = 0,
        stamp_ns: int | None = None,
        duration_s: float | None = None,
    ) -> None:
        with self._settled:
            before = self._state
            self._state = replace(
                before,
                received=before.received + received,
                integrated=before.integrated + integrated,
                dropped=before.dropped + dropped,
                stamp_ns=before.stamp_ns if stamp_ns is None else stamp_ns,
                integration_time_s=(
                    before.integration_time_s if duration_s is None else duration_s
                ),
            )
            self._settled.notify_all()
