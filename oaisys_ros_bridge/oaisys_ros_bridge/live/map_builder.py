"""Builds the map of the views on a thread of its own, so that the page need not wait for it."""

from __future__ import annotations

import logging
import queue
import threading
from typing import Self

from oaisys_core.errors import OaisysError
from oaisys_mapping.report.web_viewer import PosedImages, WebViewer
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume

_LOG = logging.getLogger(__name__)

END_TIMEOUT_S = 5.0
"""How long the thread may go on with its last view."""


class MapBuilder:
    """Fuses depth into a volume and shows its mesh; a context manager.

    Args:
        viewer: Shows the mesh.
        voxel_size_m, max_range_m: Of the volume.
    """

    def __init__(self, viewer: WebViewer, voxel_size_m: float, max_range_m: float) -> None:
        self._viewer = viewer
        self._volume = TsdfVolume(TsdfConfig(voxel_size_m=voxel_size_m, max_range_m=max_range_m))
        self._jobs: queue.Queue[PosedImages | None] = queue.Queue()
        self._is_ending = False
        self._thread = threading.Thread(target=self._work, name="map", daemon=True)
        self.fault = ""
        """Why a view is missing in the map; empty: none is."""

    def __enter__(self) -> Self:
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End the thread; views that wait are dropped."""
        self._is_ending = True
        self._jobs.put(None)
        self._thread.join(END_TIMEOUT_S)

    def add(self, view: PosedImages) -> None:
        """Have a view fused; one without depth changes nothing."""
        self._jobs.put(view)

    def reset(self) -> None:
        """Have the map begin anew, after the views that wait."""
        self._jobs.put(None)

    def _work(self) -> None:
        while True:
            view = self._jobs.get()
            if self._is_ending:
                return
            try:
                self._fuse(view)
            except OaisysError as error:
                self.fault = str(error)
                _LOG.warning("a view is missing in the map: %s", error)

    def _fuse(self, view: PosedImages | None) -> None:
        if view is None:
            self._volume.reset()
            self._viewer.clear_mesh()
            return
        if view.depth_m is None:
            return
        camera = view.camera
        self._volume.integrate(view.depth_m, view.rgb, camera.intrinsics, camera.T_map_camera)
        if self._jobs.empty():
            self._viewer.set_mesh(self._volume.extract_mesh())
