"""How true a reconstruction is: the field's standard figures against a true mesh.

Accuracy, completion and F-score as in Knapitsch et al., "Tanks and Temples", ACM TOG 36(4), 2017:
distances from points spread evenly over the reconstruction to the truth, and back. Accuracy counts
all of the reconstruction, artefacts in the air and beyond the truth's border included. Everything
about completeness counts only truth that the poses could see, so that a map is not blamed for what
a planner did not look at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy import ndimage

from oaisys_core.errors import InvalidInputError
from oaisys_core.types import FloatArray, TriangleMesh
from oaisys_mapping.mesh import ColoredMesh, SurfacePoints, sample_surface
from oaisys_mapping.visibility import View, raycasting_scene, visible_from_any, within_reach

MOST_POINTS = 1_000_000
"""Points spread over a surface, one per square of a voxel's size, or fewer where it is larger."""

HOLE_VOXELS = 2
"""How far from the truth, along its normal, a surface may lie and still close a hole; and the width
of the surveyed area's rim, where a missing surface is none: a cube needs all of its corners."""


@dataclass(frozen=True)
class ReconstructionMetrics:
    """Figures of one reconstruction. Lengths in metres, ratios from 0 to 1.

    Attributes:
        voxel_size_m: Size that "one voxel" means.
        accuracy_mean_m, rmse_m, accuracy_max_m: Distance from the reconstruction to the truth.
        completion_mean_m: Distance from the visible truth to the reconstruction.
        completion_ratio, completion_ratio_2: Share of visible truth within 1 and 2 voxels of it.
        precision, precision_2: Share of the reconstruction within 1 and 2 voxels of the truth.
        f_score, f_score_2: Harmonic mean of precision and completion at one and two voxels.
        hole_ratio: Share of the visible truth, the rim of the surveyed area apart, with nothing
            reconstructed within `HOLE_VOXELS` along its normal, on either side.
        surveyed_area_m2: Area of the visible truth as seen from above.
        visible_samples, reconstruction_samples: How many points were measured.
    """

    voxel_size_m: float
    accuracy_mean_m: float
    rmse_m: float
    accuracy_max_m: float
    completion_mean_m: float
    completion_ratio: float
    completion_ratio_2: float
    precision: float
    precision_2: float
    f_score: float
    f_score_2: float
    hole_ratio: float
    surveyed_area_m2: float
    visible_samples: int
    reconstruction_samples: int

    def to_dict(self) -> dict[str, Any]:
        """Return the figures by name."""
        return asdict(self)


@dataclass(frozen=True)
class Criterion:
    """A figure against its limit.

    Attributes:
        name: Of the figure among `ReconstructionMetrics`.
        is_upper: Whether the figure may be at most the limit, not at least.
    """

    name: str
    value: float
    limit: float
    is_upper: bool

    @property
    def holds(self) -> bool:
        """Whether the limit is kept; a figure that is no number keeps none."""
        return self.value <= self.limit if self.is_upper else self.value >= self.limit

    @property
    def asked(self) -> str:
        """The limit in words."""
        return f"at {'most' if self.is_upper else 'least'} {self.limit:g}"

    def __str__(self) -> str:
        return f"{self.name} is {self.value:.4g}, expected {self.asked}"


@dataclass(frozen=True)
class Thresholds:
    """What a reconstruction must reach to count as closed; None: not asked for."""

    max_rmse_m: float | None = None
    min_completion: float | None = None
    min_f_score: float | None = None
    max_holes: float | None = None

    def applied_to(self, metrics: ReconstructionMetrics) -> list[Criterion]:
        """Return what was asked for, and whether the figures reach it."""
        wanted = (
            ("rmse_m", self.max_rmse_m, True),
            ("completion_ratio", self.min_completion, False),
            ("f_score", self.min_f_score, False),
            ("hole_ratio", self.max_holes, True),
        )
        return [
            Criterion(name, float(getattr(metrics, name)), limit, is_upper)
            for name, limit, is_upper in wanted
            if limit is not None
        ]

    def missed_by(self, metrics: ReconstructionMetrics) -> list[str]:
        """Return one sentence for each threshold that is missed."""
        return [str(found) for found in self.applied_to(metrics) if not found.holds]


@dataclass(frozen=True)
class Evaluation:
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


def evaluate_reconstruction(
    mesh: ColoredMesh,
    truth: TriangleMesh,
    views: Sequence[View] | None,
    voxel_size_m: float,
    max_range_m: float,
    rng: np.random.Generator,
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

    Raises:
        InvalidInputError: A mesh is empty, or the views see nothing of the truth.
    """
    if not len(mesh.triangles):
        raise InvalidInputError("mesh", "0 triangles", "a reconstruction with a surface")
    if not len(truth.triangles):
        raise InvalidInputError("truth", "0 triangles", "a mesh with a surface")
    truth_scene = raycasting_scene(truth.vertices_m, truth.triangles)
    mesh_scene = raycasting_scene(mesh.vertices_m, mesh.triangles)
    visible = _visible_truth(truth, truth_scene, views, voxel_size_m, max_range_m, rng)
    points = sample_surface(mesh.vertices_m, mesh.triangles, voxel_size_m, MOST_POINTS, rng)
    to_truth_m = _distances(points.points_m, truth_scene)
    to_mesh_m = _distances(visible.points_m, mesh_scene)
    holes = _holes(mesh_scene, visible, voxel_size_m)
    metrics = _metrics(voxel_size_m, to_truth_m, to_mesh_m, holes, visible)
    return Evaluation(metrics, points, to_truth_m, visible, to_mesh_m)


def _metrics(
    voxel_size_m: float,
    to_truth_m: FloatArray,
    to_mesh_m: FloatArray,
    hole_ratio: float,
    visible: SurfacePoints,
) -> ReconstructionMetrics:
    precision, precision_2 = (float((to_truth_m <= n * voxel_size_m).mean()) for n in (1, 2))
    completion, completion_2 = (float((to_mesh_m <= n * voxel_size_m).mean()) for n in (1, 2))
    return ReconstructionMetrics(
        voxel_size_m=voxel_size_m,
        accuracy_mean_m=float(to_truth_m.mean()),
        rmse_m=float(np.sqrt(np.square(to_truth_m).mean())),
        accuracy_max_m=float(to_truth_m.max()),
        completion_mean_m=float(to_mesh_m.mean()),
        completion_ratio=completion,
        completion_ratio_2=completion_2,
        precision=precision,
        precision_2=precision_2,
        f_score=_harmonic_mean(precision, completion),
        f_score_2=_harmonic_mean(precision_2, completion_2),
        hole_ratio=hole_ratio,
        surveyed_area_m2=float(np.abs(visible.normals[:, 2]).sum()) * visible.area_m2,
        visible_samples=len(to_mesh_m),
        reconstruction_samples=len(to_truth_m),
    )


def _harmonic_mean(a: float, b: float) -> float:
    return 0.0 if a + b == 0 else 2 * a * b / (a + b)


def _visible_truth(
    truth: TriangleMesh,
    scene: Any,
    views: Sequence[View] | None,
    voxel_size_m: float,
    max_range_m: float,
    rng: np.random.Generator,
) -> SurfacePoints:
    triangles = truth.triangles
    if views is None:
        return sample_surface(truth.vertices_m, triangles, voxel_size_m, MOST_POINTS, rng)
    triangles = triangles[within_reach(truth, views, max_range_m)]
    if len(triangles):
        points = sample_surface(truth.vertices_m, triangles, voxel_size_m, MOST_POINTS, rng)
        seen = visible_from_any(points, views, scene, max_range_m)
        if seen.any():
            return points.only(seen)
    raise InvalidInputError("views", f"{len(views)} views", "views that see the truth")


def _distances(points_m: FloatArray, scene: Any) -> FloatArray:
    """Return the (N,) distances from points to the nearest place on a scene's surface."""
    query = o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
    return np.asarray(scene.compute_distance(query).numpy(), np.float64)


def _holes(mesh_scene: Any, visible: SurfacePoints, voxel_size_m: float) -> float:
    """Return `ReconstructionMetrics.hole_ratio`.

    A line along the normal finds the border of a hole where it is; distances would shrink a hole
    by their tolerance all around.
    """
    reach_m = HOLE_VOXELS * voxel_size_m
    inside = _off_the_rim(visible, reach_m)
    normals = visible.normals[inside]
    rays = np.column_stack((visible.points_m[inside] - reach_m * normals, 2 * reach_m * normals))
    # The rays are as long as the line, so what lies on it is met before 1.
    met = mesh_scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
    return float((met > 1).mean())


def _off_the_rim(visible: SurfacePoints, rim_m: float) -> NDArray[np.bool_]:
    """Return (N,) which points lie further than ``rim_m`` inside the surveyed area.

    The area is made of square cells with visible points in them, from above; gaps inside it (the
    blind side of a rock) do not make a rim. Where it is all rim, all of it counts.
    """
    cell_m = max(rim_m, 2 * float(np.sqrt(visible.area_m2)))
    xy_m = visible.points_m[:, :2]
    cells = np.floor((xy_m - xy_m.min(axis=0)) / cell_m).astype(np.intp) + 2
    seen = np.zeros(cells.max(axis=0) + 3, bool)
    seen[tuple(cells.T)] = True
    area = ndimage.binary_fill_holes(ndimage.binary_closing(seen, np.ones((3, 3))))
    inside = ndimage.binary_erosion(area, np.ones((3, 3)))[tuple(cells.T)]
    return np.asarray(inside if inside.any() else np.ones_like(inside))
