"""Intersection over union of a map's labels and those of the true surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_mapping.mesh import ColoredMesh
from oaisys_mapping.voxels.semantic_fusion import UNLABELLED

MIN_CLASS_SHARE = 0.01
"""Classes with a smaller share of the surface are reported, but not held to a limit."""


class ClassField(Protocol):
    """A map that gives classes at any point, not only at its mesh's vertices."""

    def classes_at(self, points_m: FloatArray) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Return (N,) classes at (N, 3) points, 0 for none, and their probabilities."""
        ...


@dataclass(frozen=True)
class ClassAgreement:
    """Agreement of a map's labels with those of the truth.

    Attributes:
        iou: Intersection over union by class name. Truth that the map lacks or leaves unlabelled
            belongs to no class of the map.
        share: Share of the surface by class name.
    """

    iou: Mapping[str, float] = field(default_factory=dict)
    share: Mapping[str, float] = field(default_factory=dict)

    @property
    def least(self) -> float | None:
        """Lowest IoU of the classes with at least `MIN_CLASS_SHARE`; None if there are none."""
        common = [self.iou[name] for name, share in self.share.items() if share >= MIN_CLASS_SHARE]
        return min(common, default=None)


def class_agreement(
    true_ids: NDArray[np.integer[Any]],
    map_ids: NDArray[np.integer[Any]],
    names: Mapping[int, str],
) -> ClassAgreement:
    """Compare (N,) labels at the same points; points that the truth leaves unlabelled are ignored.

    Args:
        true_ids, map_ids: Labels, `UNLABELLED` for none.
        names: Names of the labels; others are named by their number.
    """
    is_known = true_ids != UNLABELLED
    true_ids, map_ids = true_ids[is_known], map_ids[is_known]
    iou, share = {}, {}
    for class_id in np.unique(true_ids).tolist():
        is_true, is_mapped = true_ids == class_id, map_ids == class_id
        name = names.get(class_id, str(class_id))
        iou[name] = float((is_true & is_mapped).sum() / (is_true | is_mapped).sum())
        share[name] = float(is_true.mean())
    return ClassAgreement(iou, share)


def labels_at(
    points_m: FloatArray, mesh: ColoredMesh, mesh_scene: Any, reach_m: float
) -> NDArray[np.uint16]:
    """Return the (N,) label of the mesh nearest to each point, 0 where it is beyond ``reach_m``.

    Within a triangle, the corners vote with their probabilities times the barycentric coordinates.
    """
    assert mesh.class_ids is not None
    query = o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
    found = mesh_scene.compute_closest_points(query)
    corners = mesh.triangles[found["primitive_ids"].numpy().astype(np.intp)]
    u, v = found["primitive_uvs"].numpy().astype(np.float64).T
    weights = np.column_stack((1 - u - v, u, v))
    if mesh.class_probabilities is not None:
        weights *= mesh.class_probabilities[corners]
    ids = mesh.class_ids[corners]
    votes = np.stack([(weights * (ids == ids[:, [i]])).sum(axis=1) for i in range(3)], axis=1)
    label = np.take_along_axis(ids, votes.argmax(axis=1)[:, None], axis=1)[:, 0]
    away_m = np.linalg.norm(points_m - found["points"].numpy(), axis=1)
    return np.where(away_m <= reach_m, label, UNLABELLED).astype(np.uint16)


def field_labels_at(
    points_m: FloatArray, volume: ClassField, mesh_scene: Any, reach_m: float
) -> NDArray[np.uint16]:
    """Return the (N,) label of a volume where its mesh is nearest to each point, 0 beyond reach."""
    query = o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
    nearest_m = mesh_scene.compute_closest_points(query)["points"].numpy().astype(np.float64)
    label, _ = volume.classes_at(nearest_m)
    away_m = np.linalg.norm(points_m - nearest_m, axis=1)
    return np.where(away_m <= reach_m, label, UNLABELLED).astype(np.uint16)
