"""Whether an experiment's loop closes: measures its map, challenges the verdict, certifies it."""

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
from oaisys_mapping.certificate.signature import PrivateKey
from oaisys_mapping.certificate.view_files import write_views
from oaisys_mapping.evaluation.evaluate import Evaluation, Extras, evaluate_against
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.evaluation.true_surface import TrueSurface, true_surface
from oaisys_mapping.evaluation.truth_io import as_stored, write_truth
from oaisys_mapping.evaluation.visibility import PosedCamera
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.mesh_io import read_ply
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume
from oaisys_ros_bridge.experiments.progress import Reporter
from oaisys_ros_bridge.experiments.system import CONFIG_FILE, SystemOptions

MESH_FILE, TRUTH_FILE, VOLUME_FILE = "mesh.ply", "truth.ply", "volume.npz"
POSES_FILE = "poses.json"

TAUS_VOXELS = (0.2, 0.5, 1.0, 2.0)
"""Tolerances at which F-scores are told."""

LIBRARIES = ("oaisys_core", "oaisys_mapping", "oaisys_ros_bridge", "numpy", "open3d", "scipy")


@dataclass(frozen=True)
class Closure:
    """What became of an experiment's map.

    Attributes:
        evaluation: Its figures.
        mesh: The map's surface, as it was saved.
        faults: What became of the same frames with deliberate faults.
        certificate: As it was written.
    """

    evaluation: Evaluation
    mesh: ColoredMesh
    faults: Sequence[PerturbationResult]
    certificate: dict[str, Any]


def measure_and_certify(
    options: SystemOptions,
    info: SimulatorInfo,
    truth: TriangleMesh,
    views: Sequence[PosedCamera],
    frames: Sequence[PosedDepth],
    thresholds: Thresholds,
    key: PrivateKey | None,
    reporter: Reporter,
    *,
    world_seed: int | None = None,
) -> Closure:
    """Measure the map that stands in the output folder, and write poses, truth and certificate.

    Args:
        options: Of the experiment.
        info: Of the simulator at its end.
        truth: The true surface.
        views: Where the cameras were.
        frames: What they saw, to make maps with deliberate faults of; empty for none.
        thresholds: What counts as closed.
        key: Signs the certificate.
        reporter: Told what is being done.
        world_seed: What the world was drawn from, where that is not the configuration's seed.
    """
    reporter.say("measuring against the true surface")
    out = options.out
    truth = as_stored(truth)
    write_truth(out / TRUTH_FILE, truth)
    write_views(out / POSES_FILE, views)
    mesh = read_ply(out / MESH_FILE)
    voxel_size_m, rng = options.voxel_size_m, np.random.default_rng(info.seed)
    taus_m = tuple(share * voxel_size_m for share in TAUS_VOXELS)
    with reporter.stages("measuring") as on_progress:
        surface = true_surface(truth, views, voxel_size_m, options.max_range_m, rng, on_progress)
        volume = _volume(options, mesh)
        classes = volume if mesh.class_ids is not None else None
        extras = Extras(taus_m, volume, info.semantic_labels, classes, on_progress)
        evaluation = evaluate_against(surface, mesh, voxel_size_m, rng, extras)
    faults = _challenged(frames, surface, thresholds, options, info.seed, reporter)
    statement = CertificateContent(
        facts={**_facts(options, info), "world_seed": world_seed},
        config=json.loads((out / CONFIG_FILE).read_text(encoding="utf-8")),
        views=views,
        max_range_m=options.max_range_m,
        sampling_seed=info.seed,
        metrics=evaluation.metrics,
        thresholds=thresholds,
        faults=faults,
        labels=info.semantic_labels,
        files={"mesh": out / MESH_FILE, "truth": out / TRUTH_FILE},
        versions=_versions(info),
    )
    certificate = write_certificate(out / CERTIFICATE_FILE, statement, key)
    return Closure(evaluation, mesh, faults, certificate)


def _volume(options: SystemOptions, mesh: ColoredMesh) -> TsdfVolume | None:
    """Return the mapper's volume, if it was saved."""
    path: Path = options.out / VOLUME_FILE
    if not path.is_file():
        return None
    semantic = mesh.class_ids is not None
    volume = TsdfVolume(TsdfConfig(voxel_size_m=options.voxel_size_m, semantic=semantic))
    volume.load(path)
    return volume


def _challenged(
    frames: Sequence[PosedDepth],
    surface: TrueSurface,
    thresholds: Thresholds,
    options: SystemOptions,
    seed: int,
    reporter: Reporter,
) -> list[PerturbationResult]:
    if not frames:
        return []
    config = TsdfConfig(voxel_size_m=options.voxel_size_m, max_range_m=options.max_range_m)
    records = []
    for record in run_perturbation_tests(frames, surface, thresholds, config, seed):
        word = "rejected" if record.rejected else "not rejected"
        reporter.say(f"fault {record.name} ({record.what}): {word}")
        records.append(record)
    return records


def _facts(options: SystemOptions, info: SimulatorInfo) -> dict[str, Any]:
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
