"""How much of each class of the true surface a map labels as that class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from oaisys_core.types import FloatArray
from oaisys_mapping.mesh import ColoredMesh

UNLABELLED = 0

LEAST_SHARE = 0.01
"""Classes with less of the surface are told, but not asked to be right."""


class ClassField(Protocol):
    """A map that knows classes between its mesh's corners, too."""

    def classes_at(self, points_m: FloatArray) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
        """Return (N,) classes at (N, 3) points, 0 for none, and their probabilities."""
        ...


@dataclass(frozen=True)
class ClassAgreement:
    """Labels of a map against those of the truth it shows.

    Attributes:
        iou: Intersection over union by class name: the truth of the class that the map labels so,
            as a share of all that is of the class, is labelled so, or both. What the map does not
            show, or shows without a label, is of no class there.
        share: Of the surface, by class name.
    """

    iou: Mapping[str, float] = field(default_factory=dict)
    share: Mapping[str, float] = field(default_factory=dict)

    @property
    def least(self) -> float | None:
        """Lowest IoU of a class with at least `LEAST_SHARE` of the surface; None if there is none.

        A map without any labels has none to be asked for.
        """
        asked = [self.iou[name] for name, share in self.share.items() if share >= LEAST_SHARE]
        return min(asked, default=None)


def class_agreement(
    true_ids: NDArray[np.integer[Any]],
    map_ids: NDArray[np.integer[Any]],
    names: Mapping[int, str],
) -> ClassAgreement:
    """Compare (N,) labels at the same places; what the truth leaves unlabelled is not compared.

    Args:
        true_ids, map_ids: Labels; `UNLABELLED` for none.
        names: Of the labels; others are called by their number.
    """
    is_known = true_ids != UNLABELLED
    true_ids, map_ids = true_ids[is_known], map_ids[is_known]
    iou, share = {}, {}
    for class_id in np.unique(true_ids).tolist():
        is_so, is_said = true_ids == class_id, map_ids == class_id
        name = names.get(class_id, str(class_id))
        iou[name] = float((is_so & is_said).sum() / (is_so | is_said).sum())
        share[name] = float(is_so.mean())
    return ClassAgreement(iou, share)


def labels_at(
    points_m: FloatArray, mesh: ColoredMesh, mesh_scene: Any, reach_m: float
) -> NDArray[np.uint16]:
    """Return (N,) the label of the map nearest to each point, 0 where it is beyond ``reach_m``.

    A place in a triangle has the label that weighs most there: each corner's probability counts by
    how near the corner is (barycentric).
    """
    assert mesh.class_ids is not None
    query = o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
    found = mesh_scene.compute_closest_points(query)
    corners = mesh.triangles[found["primitive_ids"].numpy().astype(np.intp)]
    u, v = found["primitive_uvs"].numpy().astype(np.float64).T
    nearness = np.column_stack((1 - u - v, u, v))
    if mesh.class_probabilities is not None:
        nearness *= mesh.class_probabilities[corners]
    ids = mesh.class_ids[corners]
    votes = np.stack([(nearness * (ids == ids[:, [i]])).sum(axis=1) for i in range(3)], axis=1)
    label = np.take_along_axis(ids, votes.argmax(axis=1)[:, None], axis=1)[:, 0]
    away_m = np.linalg.norm(points_m - found["points"].numpy(), axis=1)
    return np.where(away_m <= reach_m, label, UNLABELLED).astype(np.uint16)


def field_labels_at(
    points_m: FloatArray, volume: ClassField, mesh_scene: Any, reach_m: float
) -> NDArray[np.uint16]:
    """Return (N,) the volume's label at the place of its mesh that is nearest to each point."""
    query = o3d.core.Tensor(np.ascontiguousarray(points_m, np.float32))
    nearest_m = mesh_scene.compute_closest_points(query)["points"].numpy().astype(np.float64)
    label, _ = volume.classes_at(nearest_m)
    away_m = np.linalg.norm(points_m - nearest_m, axis=1)
    return np.where(away_m <= reach_m, label, UNLABELLED).astype(np.uint16)
