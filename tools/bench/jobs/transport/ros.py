"""Times from the simulator to ROS subscribers, through a real bridge."""

from __future__ import annotations

import json
import time
from typing import Any

import psutil

from oaisys_core.geometry import pose_looking_at, pose_looking_down
from oaisys_core.types import Pose, merge
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_ros_bridge.transport import prepare_transport
from tools.bench.jobs.transport.listener import COLORED, DEPTH, TOPICS, Listener
from tools.bench.jobs.transport.processes import (
    BRIDGE,
    SMALL_WORLD,
    bridge,
    child,
    choose_ros_domain,
    server,
)
from tools.bench.settings import Say, Settings, camera
from tools.bench.worlds.panel import world_mapping

WARM_UP = 5
BLOCK = 20
"""Samples per value of processor time, which the kernel counts in hundredths of a second."""
IDLE_S = 3.0
PRESETS = ("geometry", "draft", "preview", "standard", "high")
QUICK_PRESETS = PRESETS[:4]


def publishing(settings: Settings, say: Say) -> dict[str, list[float]]:
    """Return milliseconds from a finished sample to its last message, and of the bridge's CPU.

    The worker answers from its cache of views; what it says that it took is not counted.
    """
    choose_ros_domain()
    prepare_transport()
    world = merge(SMALL_WORLD, camera(settings.width_px, settings.height_px))
    found: dict[str, list[float]] = {"publish_ms": [], "cpu_ms": []}
    with (
        server(settings, world) as address,
        bridge(settings, address),
        Listener() as listener,
    ):
        listener.wait_for_bridge()
        pose = pose_looking_down(0.0, 0.0, 12.0)
        for _ in range(WARM_UP):
            listener.view(pose, set(TOPICS))
        process = child(BRIDGE)
        idle_share = _idle_share(process)
        for block in range(settings.runs):
            say(block / settings.runs, f"{BLOCK} samples")
            busy_s, started_s = _cpu_s(process), time.perf_counter()
            for _ in range(BLOCK):
                arrivals_s, render_s = listener.view(pose, set(TOPICS))
                last_s = max(arrivals_s[topic] for topic in TOPICS)
                found["publish_ms"].append(1e3 * (last_s - render_s))
            idle_s = idle_share * (time.perf_counter() - started_s)
            found["cpu_ms"].append(1e3 * (_cpu_s(process) - busy_s - idle_s) / BLOCK)
    return found


def end_to_end(settings: Settings, say: Say) -> dict[str, dict[str, list[float]]]:
    """Return seconds from the service call to messages, by preset, with a moving camera."""
    choose_ros_domain()
    prepare_transport()
    presets = QUICK_PRESETS if settings.quick else PRESETS
    found = {}
    with (
        server(settings, world_mapping(settings), "--pose-cache-mb", "0") as address,
        bridge(settings, address),
        Listener() as listener,
        SimulatorClient(address) as client,
    ):
        say(0.0, "the demo's world")
        listener.wait_for_bridge()
        height_m = float(client.query_height([(-14.0, -10.0, 0.0)]).surface_height_m[0])
        for index, preset in enumerate(presets):
            say((1 + index) / (1 + len(presets)), preset)
            listener.set_metadata("render", json.dumps({"quality": preset}))
            topics = set(TOPICS) - (COLORED if preset == "geometry" else set())
            found[preset] = _views(listener, topics, height_m, settings.runs)
    return found


def _views(
    listener: Listener, topics: set[str], height_m: float, runs: int
) -> dict[str, list[float]]:
    rows: list[dict[str, Any]] = []
    for run in range(runs + 1):
        arrivals_s, render_s = listener.view(_pose(height_m, run), topics)
        rows.append(
            {
                "depth_s": arrivals_s[DEPTH],
                "last_s": max(arrivals_s[topic] for topic in topics),
                "render_s": render_s,
                "answer_s": arrivals_s["answer"],
            }
        )
    return {name: [row[name] for row in rows[1:]] for name in rows[0]}


def _pose(height_m: float, run: int) -> Pose:
    return pose_looking_at((-14.0 + 0.15 * run, -10.0, height_m + 6.0), (4.0, 4.0, height_m))


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _idle_share(process: psutil.Process) -> float:
    """Return the share of a core that a process uses while it is idle."""
    before_s = _cpu_s(process)
    time.sleep(IDLE_S)
    return (_cpu_s(process) - before_s) / IDLE_S
