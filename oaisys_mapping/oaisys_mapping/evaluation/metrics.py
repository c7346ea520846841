"""How true a reconstruction is: the field's standard figures against a true mesh.

Accuracy, completion and F-score as in Knapitsch et al., "Tanks and Temples", ACM TOG 36(4), 2017:
distances from points spread evenly over the reconstruction to the truth, and back. Accuracy counts
all of the reconstruction, artefacts in the air and beyond the truth's border included. Everything
about completeness is told twice: of the truth that the poses could see, which a mapper answers
for, and, with ``_all`` in its name, of all the truth there is (what is buried included), for which
a planner answers too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, ShortRepr, TriangleMesh
from oaisys_mapping.evaluation.distance_figures import (
    Completeness,
    FScore,
    distance_figures,
    f_score_at,
)
from oaisys_mapping.evaluation.field_metrics import DistanceField, FieldMetrics, field_metrics
from oaisys_mapping.evaluation.holes import Holes, find_holes, gaps, off_the_rim
from oaisys_mapping.evaluation.registration import offset_to_truth
from oaisys_mapping.evaluation.semantics import (
    ClassAgreement,
    ClassField,
    class_agreement,
    field_labels_at,
    labels_at,
)
from oaisys_mapping.evaluation.true_surface import MOST_POINTS, OVERLAP, TrueSurface, true_surface
from oaisys_mapping.evaluation.visibility import View, raycasting_scene
from oaisys_mapping.mesh import ColoredMesh, SurfacePoints, sample_surface
from oaisys_mapping.stages import StageListener, ignore_stage

OFFSET_VOXELS = 3
"""Points of a reconstruction further from the truth than this do not tell of its offset."""


@dataclass(frozen=True)
class ReconstructionMetrics:
    """Figures of one reconstruction. Lengths in metres, areas in square metres, ratios 0 to 1.

    Attributes:
        voxel_size_m: Size that "one voxel" means.
        accuracy_mean_m, accuracy_median_m, rmse_m, accuracy_max_m: Distance from the
            reconstruction to the truth.
        completion_mean_m: Distance from the visible truth to the reconstruction.
        completion_ratio, completion_ratio_2: Share of visible truth within 1 and 2 voxels of it.
        precision, precision_2: Share of the reconstruction within 1 and 2 voxels of the truth.
        f_score, f_score_2: Harmonic mean of precision and completion at one and two voxels.
        chamfer_m: Mean of ``accuracy_mean_m`` and ``completion_mean_m``.
        offset_m, offset_xyz_m: How far the reconstruction lies beside the truth as a whole;
            see `offset_to_truth`.
        hole_ratio, hole_count, hole_area_m2, largest_hole_m2: See `holes.Holes`, of the visible
            truth off the rim of the surveyed area.
        gap_ratio: Share of the same with nothing reconstructed within two voxels along its normal,
            slits too narrow to be holes included.
        overlap_area_m2: Visible truth off the rim that at least two views see.
        overlap_hole_ratio, overlap_hole_count, overlap_hole_area_m2: Holes in there.
        overlap_farthest_m: Greatest distance from the truth in there to the reconstruction.
        surveyed_area_m2: Area of the visible truth as seen from above.
        visible_share: Visible part of all of the truth.
        completion_mean_all_m, completion_ratio_all, completion_ratio_2_all, f_score_all,
            f_score_2_all, chamfer_all_m, gap_ratio_all: Of all the truth instead of the visible.
        visible_samples, truth_samples, reconstruction_samples: How many points were measured.
        past_rim_share: Share of the reconstruction beyond the outer rim of an open truth, of which
            nothing is known; the other figures leave it out.
        f_scores: At further tolerances.
        classes: Labels of the map against those of the visible truth.
        field: Figures of the distance field, where the volume was at hand.
    """

    voxel_size_m: float
    accuracy_mean_m: float
    accuracy_median_m: float
    rmse_m: float
    accuracy_max_m: float
    completion_mean_m: float
    completion_ratio: float
    completion_ratio_2: float
    precision: float
    precision_2: float
    f_score: float
    f_score_2: float
    chamfer_m: float
    offset_m: float
    offset_xyz_m: tuple[float, float, float]
    hole_ratio: float
    hole_count: int
    hole_area_m2: float
    largest_hole_m2: float
    gap_ratio: float
    overlap_area_m2: float
    overlap_hole_ratio: float
    overlap_hole_count: int
    overlap_hole_area_m2: float
    overlap_farthest_m: float
    surveyed_area_m2: float
    visible_share: float
    completion_mean_all_m: float
    completion_ratio_all: float
    completion_ratio_2_all: float
    f_score_all: float
    f_score_2_all: float
    chamfer_all_m: float
    gap_ratio_all: float
    visible_samples: int
    truth_samples: int
    reconstruction_samples: int
    past_rim_share: float = 0.0
    f_scores: tuple[FScore, ...] = ()
    classes: ClassAgreement | None = None
    field: FieldMetrics | None = None

    @property
    def least_iou(self) -> float | None:
        """Lowest IoU among the classes of the surface, see `ClassAgreement.least`."""
        return self.classes.least if self.classes is not None else None

    def to_dict(self) -> dict[str, Any]:
        """Return the figures by name, as JSON has them; those not measured are absent."""
        figures = asdict(self)
        figures["offset_xyz_m"] = list(self.offset_xyz_m)
        figures["f_scores"] = [asdict(score) for score in self.f_scores]
        del figures["classes"], figures["field"]
        if self.classes is not None:
            figures["iou"] = dict(self.classes.iou)
            figures["iou_share"] = dict(self.classes.share)
            figures["least_iou"] = self.least_iou
        return figures | (asdict(self.field) if self.field is not None else {})


@dataclass(frozen=True, repr=False)
class Evaluation(ShortRepr):
    """Figures and what they were taken from, for pictures.

    Attributes:
        reconstruction: Points on the reconstruction, with their distance to the truth in metres.
        visible_truth: Visible points of the truth, with their distance to the reconstruction.
    """

    metrics: ReconstructionMetrics
    reconstruction: SurfacePoints
    reconstruction_distance_m: FloatArray
    visible_truth: SurfacePoints
    visible_truth_distance_m: FloatArray


@dataclass(frozen=True)
class Extras:
    """What may be measured beyond the mesh's shape.

    Attributes:
        taus_m: Tolerances of further F-scores.
        volume: The distance field that the mesh was taken from.
        labels: Names of semantic ids.
        classes: The classes that the mesh's were taken from: finer than a triangle's corners.
        on_stage: Told what is being measured.
    """

    taus_m: Sequence[float] = ()
    volume: DistanceField | None = None
    labels: Mapping[int, str] | None = None
    classes: ClassField | None = None
    on_stage: StageListener = ignore_stage


def evaluate_reconstruction(
    mesh: ColoredMesh,
    truth: TriangleMesh,
    views: Sequence[View] | None,
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
        rng: Gives the points that are measured.
        extras: What else to measure.

    Raises:
        InvalidInputError: A mesh is empty, or the views see nothing of the truth.
    """
    _check_surface(mesh)
    on_stage = extras.on_stage if extras is not None else ignore_stage
    surface = true_surface(truth, views, voxel_size_m, max_range_m, rng, on_stage)
    return evaluate_against(surface, mesh, voxel_size_m, rng, extras)


def evaluate_against(
    surface: TrueSurface,
    mesh: ColoredMesh,
    voxel_size_m: float,
    rng: np.random.Generator,
    extras: Extras | None = None,
) -> Evaluation:
    """Measure a reconstruction against a truth that was made ready; see the above."""
    _check_surface(mesh)
    extras = extras or Extras()
    extras.on_stage("distances from the map to the truth")
    mesh_scene = raycasting_scene(mesh.vertices_m, mesh.triangles)
    points = sample_surface(mesh.vertices_m, mesh.triangles, voxel_size_m, MOST_POINTS, rng)
    is_past = surface.past_the_rim(points.points_m)
    if not is_past.all():
        points = points.only(~is_past)
    to_truth_m = _distances(points.points_m, surface.scene)
    extras.on_stage("distances from the truth to the map")
    to_mesh_m = _distances(surface.visible.points_m, mesh_scene)
    visible = Completeness(((to_mesh_m, surface.visible.area_m2),))
    unseen = [(_distances(p.points_m, mesh_scene), p.area_m2) for p in surface.unseen]
    everything = Completeness((*visible.parts, *unseen))
    extras.on_stage("offset, holes and classes")
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
        field=field_metrics(surface, extras.volume, voxel_size_m) if extras.volume else None,
    )
    return Evaluation(metrics, points, to_truth_m, surface.visible, to_mesh_m)


def _hole_figures(
    surface: TrueSurface, mesh_scene: Any, to_mesh_m: FloatArray, voxel_size_m: float
) -> dict[str, Any]:
    visible = surface.visible
    is_gap = gaps(visible, mesh_scene, voxel_size_m)
    inside = off_the_rim(visible, voxel_size_m)
    overlap = inside & (surface.times_seen >= OVERLAP)

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
    """Compare labels where both the map and the truth have them."""
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
