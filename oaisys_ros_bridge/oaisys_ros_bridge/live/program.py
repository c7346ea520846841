"""Starts the simulator and the page of ``oaisys live``, and ends them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

from oaisys_grpc.client.simulator_client import ClientTls
from oaisys_mapping.report.web_viewer import WebViewer
from oaisys_ros_bridge.experiments.configuration import ExperimentOptions
from oaisys_ros_bridge.live.desk import Desk
from oaisys_ros_bridge.live.map_builder import MapBuilder
from oaisys_ros_bridge.live.options import LiveOptions
from oaisys_ros_bridge.live.page import LivePage
from oaisys_ros_bridge.live.session import MOVING_QUALITY, LiveSession
from oaisys_ros_bridge.live.simulator import LiveSimulator, connect_simulator, start_simulator
from oaisys_ros_bridge.live_view.view import LONGEST_END_S, end_within


def run_live(
    options: LiveOptions,
    experiment: Mapping[str, Any],
    address: str | None,
    tls: ClientTls | None,
    say: Callable[[str], None],
) -> None:
    """Serve the page until Ctrl-C.

    Args:
        options: Of the page.
        experiment: Fields of `ExperimentOptions`, for the simulator that is started.
        address: Of a running simulator, in place of a new one.
        tls: For a running simulator that encrypts.
        say: Given each line for the terminal.

    Raises:
        OaisysError: The simulator cannot be started or reached, or has ended.
    """
    desk = Desk()
    with WebViewer(options.host, options.port, options.max_range_m) as viewer:
        page = LivePage(viewer, desk, _bag_fault())
        with suppress(KeyboardInterrupt):
            say(f"live: {viewer.url}")
            page.say("The simulator starts.")
            with _simulator(experiment, address, tls) as simulator:
                _serve(simulator, viewer, page, desk, options)
        end_within(LONGEST_END_S)


def _simulator(
    experiment: Mapping[str, Any], address: str | None, tls: ClientTls | None
) -> AbstractContextManager[LiveSimulator]:
    if address is not None:
        return connect_simulator(address, tls)
    return start_simulator(ExperimentOptions(**experiment))


def _serve(
    simulator: LiveSimulator, viewer: WebViewer, page: LivePage, desk: Desk, options: LiveOptions
) -> None:
    is_blender = simulator.client.info().backend == "blender"
    better = "standard" if is_blender else MOVING_QUALITY
    chosen = replace(options, still_quality=options.still_quality or better)
    with MapBuilder(viewer, options.voxel_size_m, options.max_range_m) as map_builder:
        session = LiveSession(simulator, viewer, page, desk, map_builder, chosen)
        try:
            session.run()
        finally:
            session.close()


def _bag_fault() -> str:
    """Return why no bag can be recorded here; empty: one can."""
    missing = [
        name for name in ("rclpy", "rosgraph_msgs", "oaisys_msgs") if find_spec(name) is None
    ]
    return f"not without ROS ({', '.join(missing)})" if missing else ""
