"""Measures a reconstruction against the true surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, ShortRepr, TriangleMesh
from oaisys_mapping.evaluation.holes import Holes, find_holes, gaps, inside_the_rim
from oaisys_mapping.evaluation.metrics import (
    Completeness,
    ReconstructionMetrics,
    distance_figures,
    f_score_at,
)
from oaisys_mapping.evaluation.registration import MIN_POINTS, offset_to_truth
from oaisys_mapping.evaluation.semantics import (
    ClassAgreement,
    ClassField,
    class_agreement,
    field_labels_at,
    labels_at,
)
from oaisys_mapping.evaluation.true_surface import (
    MAX_POINTS,
    OVERLAP_VIEWS,
    TrueSurface,
    true_surface,
)
from oaisys_mapping.evaluation.tsdf_metrics import SignedDistanceMap, tsdf_metrics
from oaisys_mapping.evaluation.visibility import PosedCamera, raycasting_scene
from oaisys_mapping.mesh import ColoredMesh, SurfacePoints, sample_surface
from oaisys_mapping.progress import ProgressCallback, ignore_progress

OFFSET_VOXELS = 3
"""Points of a reconstruction further from the truth than this are left out of its offset."""


@dataclass(frozen=True, repr=False)
class Evaluation(ShortRepr):
    """Figures, and the points and distances that they were computed from.

    Attributes:
        reconstruction: (N) points on the reconstruction.
        reconstruction_distance_m: (N,) their distances to the truth.
        visible_truth: (M) visible points of the truth.
        visible_truth_distance_m: (M,) their distances to the reconstruction.
    """

    metrics: ReconstructionMetrics
    reconstruction: SurfacePoints
    reconstruction_distance_m: FloatArray
    visible_truth: SurfacePoints
    visible_truth_distance_m: FloatArray

    @property
    def missing_figures(self) -> dict[str, str]:
        """Figures with a limit that nothing was measured of, by name, and what is missing."""
        metrics, missing = self.metrics, {}
        near = self.reconstruction_distance_m <= OFFSET_VOXELS * metrics.voxel_size_m
        if near.sum() < MIN_POINTS:
            reach_m = OFFSET_VOXELS * metrics.voxel_size_m
            missing["offset_m"] = f"no part of the map is within {reach_m:g} m of the truth"
        if not metrics.overlap_area_m2:
            missing["overlap_hole_count"] = "no part of the truth is seen by two views"
        if metrics.least_iou is None:
            missing["least_iou"] = "no labels to measure in both meshes, of 1 % of the surface"
        return missing


@dataclass(frozen=True)
class Extras:
    """What else to measure besides the shape of the mesh.

    Attributes:
        taus_m: Tolerances of further F-scores.
        volume: The signed distances that the mesh was extracted from.
        labels: Names of semantic ids.
        classes: The classes of the volume, at a finer resolution than the mesh's vertices.
        on_progress: Called with what is being measured.
    """

    taus_m: Sequence[float] = ()
    volume: SignedDistanceMap | None = None
    labels: Mapping[int, str] | None = None
    classes: ClassField | None = None
    on_progress: ProgressCallback = ignore_progress


def evaluate_reconstruction(
    mesh: ColoredMesh,
    truth: TriangleMesh,
    views: Sequence[PosedCamera] | None,
    voxel_size_m: float,
    max_range_m: float,
    rng: np.random.Generator,
    extras: Extras | None = None,
) -> Evaluation:
    """Measure a reconstruction against the truth.

    Args:
        mesh: The reconstruction.
        truth: The true surface, in the same frame, its triangles wound counter-clockwise from
            outside.
        views: Where the cameras were; None: all truth counts as visible.
        voxel_size_m: The tolerance of completion and F-score.
        max_range_m: Depth beyond which nothing counts as visible.
        rng: Draws the points that are measured.
        extras: What else to measure.

    Raises:
        InvalidInputError: A mesh is empty, or the views see nothing of the truth.
    """
    _check_surface(mesh)
    on_progress = extras.on_progress if extras is not None else ignore_progress
    surface = true_surface(truth, views, voxel_size_m, max_range_m, rng, on_progress)
    return evaluate_against(surface, mesh, voxel_size_m, rng, extras)


def evaluate_against(
    surface: TrueSurface,
    mesh: ColoredMesh,
    voxel_size_m: float,
    rng: np.random.Generator,
    extras: Extras | None = None,
) -> Evaluation:
    """Measure a reconstruction against a prepared truth; see `evaluate_reconstruction`."""
    _check_surface(mesh)
    extras = extras or Extras()
    extras.on_progress("distances from the map to the truth")
    mesh_scene = raycasting_scene(mesh.vertices_m, mesh.triangles)
    points = sample_surface(mesh.vertices_m, mesh.triangles, voxel_size_m, MAX_POINTS, rng)
    is_past = surface.past_the_rim(points.points_m)
    if not is_past.all():
        points = points.only(~is_past)
    to_truth_m = _distances(points.points_m, surface.scene)
    extras.on_progress("distances from the truth to the map")
    to_mesh_m = _distances(surface.visible.points_m, mesh_scene)
    visible = Completeness(((to_mesh_m, surface.visible.area_m2),))
    unseen = [(_distances(p.points_m, mesh_scene), p.area_m2) for p in surface.unseen]
    everything = Completeness((*visible.parts, *unseen))
    extras.on_progress("offset, holes and classes")
    offset_m = offset_to_truth(points.points_m, surface.scene, OFFSET_VOXELS * voxel_size_m)
    metrics = ReconstructionMetrics(
        voxel_size_m=voxel_size_m,
        **distance_figures(to_truth_m, visible, everything, voxel_size_m),
        **_hole_figures(surface, mesh_scene, to_mesh_m, voxel_size_m),
        offset_m=float(np.linalg.norm(offset_m)),
        offset_xyz_m=(float(offset_m[0]), float(offset_m[1]), float(offset_m[2])),
        surveyed_area_m2=_area_from_above_m2(surface.visible),
        visible_share=surface.visible_share,
        visible_samples=len(to_mesh_m),
        truth_samples=sum(len(distance_m) for distance_m, _ in everything.parts),
        reconstruction_samples=len(to_truth_m),
        past_rim_share=float(is_past.mean()),
        f_scores=tuple(f_score_at(t, to_truth_m, visible, everything) for t in extras.taus_m),
        classes=_classes(surface, mesh, mesh_scene, extras, voxel_size_m),
        tsdf=tsdf_metrics(surface, extras.volume, voxel_size_m) if extras.volume else None,
    )
    return Evaluation(metrics, points, to_truth_m, surface.visible, to_mesh_m)


def _hole_figures(
    surface: TrueSurface, mesh_scene: Any, to_mesh_m: FloatArray, voxel_size_m: float
) -> dict[str, Any]:
    visible = surface.visible
    is_gap = gaps(visible, mesh_scene, voxel_size_m)
    inside = inside_the_rim(visible, voxel_size_m)
    overlap = inside & (surface.times_seen >= OVERLAP_VIEWS)

    def holes_in(part: NDArray[np.bool_]) -> Holes:
        return find_holes(visible.only(part), is_gap[part], to_mesh_m[part], voxel_size_m)

    all_holes, overlap_holes = holes_in(inside), holes_in(overlap)
    gap_parts = [(is_gap.astype(float), visible.area_m2)]
    gap_parts += [
        (gaps(points, mesh_scene, voxel_size_m).astype(float), points.area_m2)
        for points in surface.unseen
    ]
    return {
        "hole_ratio": all_holes.ratio,
        "hole_count": all_holes.count,
        "hole_area_m2": all_holes.area_m2,
        "largest_hole_m2": all_holes.largest_m2,
        "gap_ratio": float(is_gap[inside].mean()),
        "gap_ratio_all": Completeness(tuple(gap_parts)).mean_m,
        "overlap_area_m2": float(overlap.sum()) * visible.area_m2,
        "overlap_hole_ratio": overlap_holes.ratio,
        "overlap_hole_count": overlap_holes.count,
        "overlap_hole_area_m2": overlap_holes.area_m2,
        "overlap_farthest_m": float(to_mesh_m[overlap].max(initial=0.0)),
    }


def _classes(
    surface: TrueSurface,
    mesh: ColoredMesh,
    mesh_scene: Any,
    extras: Extras,
    voxel_size_m: float,
) -> ClassAgreement | None:
    """Compare labels if both the map and the truth have them."""
    true_ids = surface.mesh.semantic_ids
    if (mesh.class_ids is None and extras.classes is None) or true_ids is None:
        return None
    visible = surface.visible
    if extras.classes is not None:
        map_ids = field_labels_at(visible.points_m, extras.classes, mesh_scene, voxel_size_m)
    else:
        map_ids = labels_at(visible.points_m, mesh, mesh_scene, voxel_size_m)
    return class_agreement(true_ids[visible.triangle_ids], map_ids, extras.labels or {})


def _check_surface(mesh: ColoredMesh) -> None:
    if not len(mesh.triangles):
        raise InvalidInputError("mesh", "0 triangles", "a reconstruction with a surface")


def _area_from_above_m2(points: SurfacePoints) -> float:
    return float(np.abs(points.normals[:, 2]).sum()) * points.area_m2


def _distances(points_m: FloatArray, scene: Any) -> FloatArray:
    """Return the (N,) distances from points to the nearest place on a scene's surface."""
    query = o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
    return np.asarray(scene.compute_distance(query).numpy(), np.float64)
