"""The live view: takes what comes from gRPC or ROS and shows it in a browser."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from oaisys_mapping.report.web_viewer import PosedImages, WebViewer
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_ros_bridge.experiments.interruption import raise_if_interrupted
from oaisys_ros_bridge.live_view.source import GrpcSource, ViewSource

DEFAULT_ADDRESS = "127.0.0.1:50051"
NEWS_TIMEOUT_S = 0.5

END_S = 2.0
"""Once all is saved: viser waits 6 s for browsers that do not answer, or for ever."""


@dataclass(frozen=True)
class ViewOptions:
    """What is shown, and where.

    Attributes:
        address: Of the server to watch; None: the usual one.
        ros: Watch topics instead.
        cameras: Prefixes of the cameras' topics.
        map_frame: Frame to show everything in.
        host, port: Where the page is served; port 0 is a free one.
        voxel_size_m, max_range_m: Of the mesh that is made here, and how far clouds reach.
        views: End after so many; None: when interrupted.
        save: File that the scene is written to at the end, or None.
    """

    address: str | None
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
    """Show what comes until enough has come, or Ctrl-C; then the process ends within `END_S`.

    Raises:
        OaisysError: The server cannot be reached any more.
    """
    with (
        _source(options) as source,
        WebViewer(options.host, options.port, options.max_range_m) as page,
    ):
        say(f"view: {page.url}")
        with suppress(KeyboardInterrupt):
            _show(source, page, options, say)
        if options.save is not None:
            page.save(options.save)
            say(f"saved: {options.save}")
        _end_within(END_S)


def _end_within(seconds: float) -> None:
    """End this process with exit code 0 where it has not come to its end by itself by then."""
    timer = threading.Timer(seconds, os._exit, (0,))
    timer.daemon = True
    timer.start()


def _source(options: ViewOptions) -> ViewSource:
    if not options.ros:
        return GrpcSource(options.address or DEFAULT_ADDRESS)
    # Watching a server needs no ROS.
    from oaisys_ros_bridge.live_view.ros_source import RosSource

    return RosSource(options.cameras, options.map_frame)


def _show(
    source: ViewSource, page: WebViewer, options: ViewOptions, say: Callable[[str], None]
) -> None:
    volume = TsdfVolume(
        TsdfConfig(voxel_size_m=options.voxel_size_m, max_range_m=options.max_range_m)
    )
    shown = 0
    while options.views is None or shown < options.views:
        raise_if_interrupted()
        news = source.news(NEWS_TIMEOUT_S)
        if news is None:
            continue
        if news.new_world:
            page.clear()
            volume.reset()
        page.labels = source.labels
        for view in news.views:
            page.add(view)
            if not source.tells_mesh:
                _fuse(volume, view)
        shown += len(news.views)
        mesh = news.mesh
        if mesh is None and news.views and not source.tells_mesh:
            mesh = volume.extract_mesh()
        if mesh is not None:
            page.set_mesh(mesh)
            say(f"{shown} views, {len(mesh.triangles)} triangles")


def _fuse(volume: TsdfVolume, view: PosedImages) -> None:
    if view.depth_m is not None:
        camera = view.camera
        volume.integrate(view.depth_m, view.rgb, camera.intrinsics, camera.T_map_camera)
