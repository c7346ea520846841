"""Renders a certificate's views again, maps them, and compares the figures; without ROS."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.errors import InvalidInputError, OaisysError
from oaisys_core.geometry import invert, pose_from_matrix
from oaisys_core.system.ending.leftovers import temporary_folder
from oaisys_core.system.processes import ManagedProcess
from oaisys_core.system.python_programs import python_command
from oaisys_core.types import DEPTH, SEMANTIC_0, Frame, TriangleMesh
from oaisys_grpc.client.simulator_client import SimulatorClient
from oaisys_mapping.certificate.verification import CheckResult, measure_again
from oaisys_mapping.certificate.view_files import views_from_json
from oaisys_mapping.evaluation.truth_io import as_stored
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.rectification import rectify, rectify_camera, rectify_labels
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_ros_bridge.experiments.bringup import START_TIMEOUT_S
from oaisys_ros_bridge.experiments.configuration import CONFIG_FILE
from oaisys_ros_bridge.experiments.progress import Reporter


def render_and_compare(
    content: Mapping[str, Any], worker_python: Path | None, reporter: Reporter
) -> list[CheckResult]:
    """Return whether the figures of a map that is rendered again agree with a certificate.

    Args:
        content: Of the certificate.
        worker_python: Interpreter that has ``bpy``; None: this one.
        reporter: Says what is being done.

    Raises:
        InvalidInputError: The certificate lacks what is needed.
        OaisysError: The simulator failed.
    """
    views = views_from_json(content["views"], "FILE: views")
    with temporary_folder("oaisys_certificate_") as folder:
        volume, truth, sha256 = _render_world_again(content, views, worker_python, folder, reporter)
    stated = content["facts"].get("config_sha256")
    findings = [CheckResult("the simulator's own hash of the configuration", sha256 == stated)]
    classes = volume if volume.config.semantic else None
    return [*findings, *measure_again(content, volume.extract_mesh(), truth, classes)]


def _render_world_again(
    content: Mapping[str, Any],
    views: Sequence[PosedCamera],
    worker_python: Path | None,
    folder: Path,
    reporter: Reporter,
) -> tuple[TsdfVolume, TriangleMesh, str]:
    """Return the map, the truth, and the hash of the configuration of a new rendering."""
    config = folder / CONFIG_FILE
    config.write_text(json.dumps(content["config"]), encoding="utf-8")
    command = python_command("oaisys_grpc", "serve", "--config", str(config))
    command += ["--address", "127.0.0.1:0"]
    if worker_python is not None:
        command += ["--worker-python", str(worker_python)]
    reporter.say("starting the simulator")
    # What the server's processes leave behind, too, where this command is killed.
    environment = {**os.environ, "TMPDIR": str(folder)}
    with ManagedProcess("server", command, folder / "server.log", environment) as server:
        address = server.wait_for_line("ready:", START_TIMEOUT_S)
        with SimulatorClient(address, timeout_s=START_TIMEOUT_S) as simulator:
            reporter.say("building the world")
            simulator.step_batch(seed=content["facts"].get("world_seed"))
            volume = _map_views(content, views, simulator, reporter)
            truth = as_stored(simulator.ground_truth_mesh())
            return volume, truth, simulator.info().config_sha256


def _map_views(
    content: Mapping[str, Any],
    views: Sequence[PosedCamera],
    simulator: SimulatorClient,
    reporter: Reporter,
) -> TsdfVolume:
    """Return the map of the views."""
    sensor = simulator.info().sensors[0]
    figures = content["figures"]
    has_labels = figures.get("least_iou") is not None
    modalities = [DEPTH, *([SEMANTIC_0] if has_labels else [])]
    volume = TsdfVolume(
        TsdfConfig(
            voxel_size_m=figures["voxel_size_m"],
            max_range_m=content["max_range_m"],
            semantic=has_labels,
        )
    )
    T_camera_base = invert(sensor.T_base_camera)
    for view in reporter.track(views, "views"):
        pose = pose_from_matrix(view.T_map_camera @ T_camera_base)
        sample = simulator.render_sample(pose, modalities=modalities, sensors=[sensor.name])
        frame = sample.frame(sensor.name, DEPTH)
        _check_same_camera(frame, view)
        depth_m, _ = rectify(frame.data, None, frame.intrinsics)
        labels = None
        if has_labels:
            found = sample.frame(sensor.name, SEMANTIC_0).data
            labels = rectify_labels(found, frame.intrinsics)
        camera = rectify_camera(frame.intrinsics)
        volume.integrate(depth_m, None, camera, frame.T_map_camera, labels)
        reporter.step(f"rendered in {sample.render_time_s:.2f} s")
    return volume


def _check_same_camera(frame: Frame, view: PosedCamera) -> None:
    camera = rectify_camera(frame.intrinsics)
    if not np.allclose(camera.K, view.intrinsics.K):
        raise InvalidInputError("FILE: views", view.intrinsics.K.tolist(), f"K {camera.K.tolist()}")
    if not np.allclose(frame.T_map_camera, view.T_map_camera, atol=1e-6):
        raise OaisysError("the simulator's camera is not where the certificate's was")
