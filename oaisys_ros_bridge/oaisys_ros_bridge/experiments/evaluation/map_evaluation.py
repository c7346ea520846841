"""Evaluates an experiment's map against the true surface, and writes its certificate."""

from __future__ import annotations

import json
import platform
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from oaisys_core.types import SimulatorInfo, TriangleMesh
from oaisys_mapping.certificate.certificate import (
    CERTIFICATE_FILE,
    CertificateContent,
    write_certificate,
)
from oaisys_mapping.certificate.perturbations import (
    PerturbationResult,
    PosedDepth,
    run_perturbation_tests,
)
from oaisys_mapping.certificate.view_files import write_views
from oaisys_mapping.evaluation.evaluate import Evaluation, Extras, evaluate_against
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.evaluation.true_surface import TrueSurface, true_surface
from oaisys_mapping.evaluation.truth_io import as_stored, write_truth
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import read_ply
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_ros_bridge.experiments.configuration import (
    CONFIG_FILE,
    MESH_FILE,
    TRUTH_FILE,
    VOLUME_FILE,
    ExperimentOptions,
)
from oaisys_ros_bridge.experiments.progress import Reporter

POSES_FILE = "poses.json"

TAUS_VOXELS = (0.2, 0.5, 1.0, 2.0)
"""Tolerances of the F-scores, in voxels."""

LIBRARIES = ("oaisys_core", "oaisys_mapping", "oaisys_ros_bridge", "numpy", "open3d", "scipy")


@dataclass(frozen=True)
class MapEvaluation:
    """The result of an experiment's evaluation.

    Attributes:
        evaluation: Of the map against the true surface.
        thresholds: That the map must meet.
        cameras: Of the map's views.
        mesh: The map's surface, as it was saved.
        faults: The verdicts on maps of the same frames with deliberate faults.
        certificate: As it was written.
    """

    evaluation: Evaluation
    thresholds: Thresholds
    cameras: Sequence[PosedCamera]
    mesh: ColoredMesh
    faults: Sequence[PerturbationResult]
    certificate: dict[str, Any]


def evaluate_and_certify(
    options: ExperimentOptions,
    info: SimulatorInfo,
    truth: TriangleMesh,
    views: Sequence[PosedCamera],
    frames: Sequence[PosedDepth],
    thresholds: Thresholds,
    reporter: Reporter,
    *,
    world_seed: int | None = None,
) -> MapEvaluation:
    """Evaluate the map in the output folder, and write poses, truth and certificate beside it.

    Args:
        options: Of the experiment.
        info: Of the simulator at its end.
        truth: The true surface.
        views: The cameras of the map's views.
        frames: Their depth images, for the perturbation test; empty: without one.
        thresholds: That the map must meet.
        reporter: Says what is being done.
        world_seed: Seed of the world, where it is not the configuration's.
    """
    reporter.say("measuring against the true surface")
    truth = as_stored(truth)
    write_truth(options.out / TRUTH_FILE, truth)
    write_views(options.out / POSES_FILE, views)
    mesh = read_ply(options.out / MESH_FILE)
    rng = np.random.default_rng(info.seed)
    with reporter.stages("measuring") as on_progress:
        surface = true_surface(
            truth, views, options.voxel_size_m, options.max_range_m, rng, on_progress
        )
        volume = _volume(options, mesh)
        classes = volume if mesh.class_ids is not None else None
        taus_m = tuple(share * options.voxel_size_m for share in TAUS_VOXELS)
        extras = Extras(taus_m, volume, info.semantic_labels, classes, on_progress)
        evaluation = evaluate_against(surface, mesh, options.voxel_size_m, rng, extras)
    config = TsdfConfig(voxel_size_m=options.voxel_size_m, max_range_m=options.max_range_m)
    faults: list[PerturbationResult] = []
    if frames:
        faults = run_perturbations(frames, surface, thresholds, config, info.seed, reporter)
    statement = _statement(options, info, views, evaluation, thresholds, faults, world_seed)
    certificate = write_certificate(options.out / CERTIFICATE_FILE, statement, options.key)
    return MapEvaluation(evaluation, thresholds, views, mesh, faults, certificate)


def _volume(options: ExperimentOptions, mesh: ColoredMesh) -> TsdfVolume | None:
    """Return the mapper's volume, if it was saved."""
    path: Path = options.out / VOLUME_FILE
    if not path.is_file():
        return None
    semantic = mesh.class_ids is not None
    volume = TsdfVolume(TsdfConfig(voxel_size_m=options.voxel_size_m, semantic=semantic))
    volume.load(path)
    return volume


def run_perturbations(
    frames: Sequence[PosedDepth],
    surface: TrueSurface,
    thresholds: Thresholds,
    config: TsdfConfig,
    seed: int,
    reporter: Reporter,
) -> list[PerturbationResult]:
    """Return the verdicts on maps of the same frames, without and with each deliberate fault."""
    records = []
    for record in run_perturbation_tests(frames, surface, thresholds, config, seed):
        verdict = "rejected" if record.is_rejected else "accepted"
        reporter.say(f"perturbation test, {record.name} ({record.what}): {verdict}")
        records.append(record)
    return records


def _statement(
    options: ExperimentOptions,
    info: SimulatorInfo,
    views: Sequence[PosedCamera],
    evaluation: Evaluation,
    thresholds: Thresholds,
    faults: Sequence[PerturbationResult],
    world_seed: int | None,
) -> CertificateContent:
    out = options.out
    return CertificateContent(
        facts={**_facts(options, info), "world_seed": world_seed},
        config=json.loads((out / CONFIG_FILE).read_text(encoding="utf-8")),
        views=views,
        max_range_m=options.max_range_m,
        sampling_seed=info.seed,
        metrics=evaluation.metrics,
        thresholds=thresholds,
        perturbations=faults,
        labels=info.semantic_labels,
        files={"mesh": out / MESH_FILE, "truth": out / TRUTH_FILE},
        versions=_versions(info),
        light=options.light,
    )


def _facts(options: ExperimentOptions, info: SimulatorInfo) -> dict[str, Any]:
    return {
        "command": shlex.join(options.command),
        "seed": info.seed,
        "batch_id": info.batch_id,
        "config_sha256": info.config_sha256,
        "backend": info.backend,
        "backend_version": info.backend_version,
        "blender_version": info.backend_version if info.backend == "blender" else None,
        "quality": info.quality,
        "device": info.device,
    }


def _versions(info: SimulatorInfo) -> dict[str, str]:
    return {
        **{name: metadata.version(name) for name in LIBRARIES},
        info.backend: info.backend_version,
        "python": platform.python_version(),
        "platform": platform.platform(),
    }
