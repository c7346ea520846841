"""Perturbation tests: maps of deliberately wrong frames, which the thresholds must reject.

Each perturbation is a mistake that real systems made: a wrong focal length, a camera mounted two
centimetres away from its modelled pose, range taken for depth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oaisys_core.geometry import pixel_rays
from oaisys_core.types import FloatArray, PinholeIntrinsics, ShortRepr
from oaisys_mapping.evaluation.evaluate import evaluate_against
from oaisys_mapping.evaluation.metrics import ReconstructionMetrics
from oaisys_mapping.evaluation.thresholds import Thresholds
from oaisys_mapping.evaluation.true_surface import TrueSurface
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.rectification import rectify, rectify_camera
from oaisys_mapping.tsdf import TsdfConfig, TsdfVolume

FOCAL_FACTOR = 1.0855
"""Factor by which depth of the original OAISYS had to be divided for its maps to close."""

POSE_ERROR_M = 0.02
SCATTER_SEED = 0

REPORTED_FIGURES = (
    "rmse_m",
    "accuracy_mean_m",
    "accuracy_median_m",
    "offset_m",
    "completion_ratio",
    "precision",
    "f_score",
    "chamfer_m",
    "hole_ratio",
    "overlap_hole_count",
)
"""Figures that are reported for each perturbation."""


@dataclass(frozen=True, repr=False)
class PosedDepth(ShortRepr):
    """A depth image with its camera and pose.

    Attributes:
        depth_m: (H, W) float32 planar depth.
        intrinsics: The camera; images with distortion are rectified before they are integrated.
        T_map_camera: (4, 4) pose of its optical frame.
    """

    depth_m: NDArray[np.float32]
    intrinsics: PinholeIntrinsics
    T_map_camera: FloatArray


@dataclass(frozen=True)
class Perturbation:
    """A deliberate error in the frames.

    Attributes:
        name: Identifier in JSON.
        what: Description.
        applied: Returns the perturbed frame for a correct one and its index.
    """

    name: str
    what: str
    applied: Callable[[PosedDepth, int], PosedDepth]


@dataclass(frozen=True)
class PerturbationResult:
    """The evaluation of a map of perturbed frames; the first one is unperturbed.

    Attributes:
        name, what: See `Perturbation`.
        figures: The `REPORTED_FIGURES`.
        missed: One sentence for each missed threshold.
    """

    name: str
    what: str
    figures: Mapping[str, float]
    missed: Sequence[str]

    @property
    def is_rejected(self) -> bool:
        """Whether the map misses a threshold."""
        return bool(self.missed)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        return {
            "name": self.name,
            "what": self.what,
            "figures": dict(self.figures),
            "missed": list(self.missed),
            "rejected": self.is_rejected,
        }


def _keep(frame: PosedDepth, _: int) -> PosedDepth:
    return frame


def _with_wrong_focal_length(frame: PosedDepth, _: int) -> PosedDepth:
    camera = frame.intrinsics
    fx_px, fy_px = FOCAL_FACTOR * camera.fx_px, FOCAL_FACTOR * camera.fy_px
    return replace(frame, intrinsics=replace(camera, fx_px=fx_px, fy_px=fy_px))


def _shift(frame: PosedDepth, shift_m: FloatArray) -> PosedDepth:
    T_map_camera = frame.T_map_camera.copy()
    T_map_camera[:3, 3] += shift_m
    return replace(frame, T_map_camera=T_map_camera)


def _shift_sideways(frame: PosedDepth, _: int) -> PosedDepth:
    return _shift(frame, POSE_ERROR_M * np.array((1.0, 0.0, 0.0)))


def _shift_up(frame: PosedDepth, _: int) -> PosedDepth:
    return _shift(frame, POSE_ERROR_M * np.array((0.0, 0.0, 1.0)))


def _shift_randomly(frame: PosedDepth, index: int) -> PosedDepth:
    direction = np.random.default_rng([SCATTER_SEED, index]).normal(size=3)
    return _shift(frame, POSE_ERROR_M * direction / np.linalg.norm(direction))


def _range_as_depth(frame: PosedDepth, _: int) -> PosedDepth:
    rays = pixel_rays(frame.intrinsics).reshape(*frame.depth_m.shape, 3)
    range_m = frame.depth_m * np.linalg.norm(rays, axis=-1)
    return replace(frame, depth_m=range_m.astype(np.float32))


UNPERTURBED = Perturbation("none", "the frames as they are", _keep)
PERTURBATIONS = (
    Perturbation("focal_length", f"focal length times {FOCAL_FACTOR:g}", _with_wrong_focal_length),
    Perturbation(
        "pose_beside", f"every pose {POSE_ERROR_M * 100:g} cm to the east", _shift_sideways
    ),
    Perturbation("pose_above", f"every pose {POSE_ERROR_M * 100:g} cm too high", _shift_up),
    Perturbation(
        "pose_scattered",
        f"every pose {POSE_ERROR_M * 100:g} cm off, each to another side",
        _shift_randomly,
    ),
    Perturbation("range_as_depth", "length along the ray taken for depth along z", _range_as_depth),
)


def mesh_of(
    frames: Sequence[PosedDepth], perturbation: Perturbation, config: TsdfConfig
) -> ColoredMesh:
    """Return the surface that a mapper makes of perturbed frames."""
    volume = TsdfVolume(config)
    for index, right in enumerate(frames):
        frame = perturbation.applied(right, index)
        depth_m, _ = rectify(frame.depth_m, None, frame.intrinsics)
        volume.integrate(depth_m, None, rectify_camera(frame.intrinsics), frame.T_map_camera)
    return volume.extract_mesh()


def run_perturbation_tests(
    frames: Sequence[PosedDepth],
    surface: TrueSurface,
    thresholds: Thresholds,
    config: TsdfConfig,
    seed: int,
) -> Iterator[PerturbationResult]:
    """Yield the results of the unperturbed frames and of each of `PERTURBATIONS`.

    Args:
        frames: The recorded frames.
        surface: The truth visible from their true poses.
        thresholds: Thresholds that only the unperturbed map should meet.
        config: Configuration of the map.
        seed: Seed of the measured points.
    """
    for perturbation in (UNPERTURBED, *PERTURBATIONS):
        mesh = mesh_of(frames, perturbation, config)
        if not len(mesh.triangles):
            yield PerturbationResult(
                perturbation.name, perturbation.what, {}, ["no surface is left"]
            )
            continue
        rng = np.random.default_rng(seed)
        metrics = evaluate_against(surface, mesh, config.voxel_size_m, rng).metrics
        missed = thresholds.misses_of(metrics)
        yield PerturbationResult(
            perturbation.name, perturbation.what, figures_to_report(metrics), missed
        )


def figures_to_report(metrics: ReconstructionMetrics) -> dict[str, float]:
    """Return the figures that are reported for a perturbation."""
    return {name: getattr(metrics, name) for name in REPORTED_FIGURES}
