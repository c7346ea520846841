"""Shows what a source receives in a browser."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from oaisys_grpc.client.simulator_client import ClientTls
from oaisys_mapping.report.web_viewer import PosedImages, WebViewer
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_ros_bridge.experiments.interruption import raise_if_interrupted
from oaisys_ros_bridge.live_view.source import GrpcSource, LiveSource

DEFAULT_ADDRESS = "127.0.0.1:50051"
UPDATE_TIMEOUT_S = 0.5

LONGEST_END_S = 2.0
"""After which the process exits: viser waits 6 s or more for browsers that do not answer."""


@dataclass(frozen=True)
class ViewOptions:
    """Options of a live view.

    Attributes:
        address: Of the server to show; None: the default address.
        tls: For a server that encrypts; None: without.
        ros: Show ROS topics instead.
        cameras: Prefixes of the cameras' topics.
        map_frame: Frame in which everything is shown.
        host, port: Of the page; port 0: a free one.
        voxel_size_m: Of the mesh that is made here.
        max_range_m: Largest depth in clouds and in that mesh.
        views: Number of views after which it ends; None: when interrupted.
        save: File to which the scene is written at the end, or None.
    """

    address: str | None
    tls: ClientTls | None
    ros: bool
    cameras: Sequence[str]
    map_frame: str
    host: str
    port: int
    voxel_size_m: float
    max_range_m: float
    views: int | None
    save: Path | None


def run_view(options: ViewOptions, say: Callable[[str], None]) -> None:
    """Show views until there are enough, or Ctrl-C; the process ends within `LONGEST_END_S` then.

    Raises:
        OaisysError: The server cannot be reached.
    """
    with (
        _source(options) as source,
        WebViewer(options.host, options.port, options.max_range_m) as page,
    ):
        with suppress(KeyboardInterrupt):
            say(f"view: {page.url}")
            _show(source, page, options, say)
        if options.save is not None:
            page.save(options.save)
            say(f"saved: {options.save}")
        end_within(LONGEST_END_S)


def end_within(seconds: float) -> None:
    """Exit with code 0 after ``seconds``, unless the process has ended by itself."""
    timer = threading.Timer(seconds, os._exit, (0,))
    timer.daemon = True
    timer.start()


def _source(options: ViewOptions) -> LiveSource:
    if not options.ros:
        return GrpcSource(options.address or DEFAULT_ADDRESS, options.tls)
    # A server can be shown without ROS.
    from oaisys_ros_bridge.live_view.ros_source import RosSource

    return RosSource(options.cameras, options.map_frame)


def _show(
    source: LiveSource, page: WebViewer, options: ViewOptions, say: Callable[[str], None]
) -> None:
    volume = TsdfVolume(
        TsdfConfig(voxel_size_m=options.voxel_size_m, max_range_m=options.max_range_m)
    )
    shown, triangles = 0, 0
    while options.views is None or shown < options.views:
        raise_if_interrupted()
        update = source.next_update(UPDATE_TIMEOUT_S)
        if update is None:
            continue
        if update.new_world:
            page.clear()
            volume.reset()
            triangles = 0
        page.labels = source.labels
        for view in update.views:
            page.add(view)
            if not source.has_mesh:
                _fuse(volume, view)
        shown += len(update.views)
        mesh = update.mesh
        if mesh is None and update.views and not source.has_mesh:
            mesh = volume.extract_mesh()
        if mesh is not None:
            page.set_mesh(mesh)
            triangles = len(mesh.triangles)
        # The last views may come without a mesh, when the mapper sends its own.
        if mesh is not None or update.views:
            say(f"{shown} views, {triangles} triangles")


def _fuse(volume: TsdfVolume, view: PosedImages) -> None:
    if view.depth_m is not None:
        camera = view.camera
        volume.integrate(view.depth_m, view.rgb, camera.intrinsics, camera.T_map_camera)
